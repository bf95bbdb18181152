"""The thresholds of results, and the words of verdicts, wherever they are printed."""

VERDICT_WORDS = {
    'none': 'these data show no misfit beyond noise', 'named': 'the cause is identified',
    'ambiguous': 'several causes explain the misfit',
    'unknown': 'no known cause explains the misfit',
}
"""A verdict in words: console, report, and the page of any simulator."""

MATERIAL = 1e-3
"""Share of a channel's range below which a misfit is immaterial."""

CHANCE = 0.01
"""Probability above which a finding counts as chance."""

GOOD = 2.0
"""A misfit below this multiple of the noise floor is as good as the measurement."""

MAX_COMPARISON_ERROR = 2.0
"""Largest comparison error over validation uncertainty (ASME V&V 20) without a model error."""

MIN_RATING = 0.8
"""Smallest ISO 18571 rating of a good curve."""


def allowed_misfit(noise_floor: float | None) -> float:
    """The largest misfit that is as good as the measurement, as a share of the channel's range."""
    return max(GOOD * (noise_floor or 0.0), MATERIAL)


def is_left(p_value: float | None, share_of_range: float | None) -> bool:
    """Whether a part of the misfit is neither chance nor too small to matter."""
    return (p_value is not None and p_value < CHANCE
            and share_of_range is not None and share_of_range >= MATERIAL)
