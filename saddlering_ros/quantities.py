"""Numbers as a person reads them or JSON allows them, the thresholds of results, their words.

Console, report, live page and messages print their numbers with these functions.
"""

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
import math
from typing import Any

import numpy as np

PREFIXES = ((1e6, 'M'), (1e3, 'k'), (1.0, ''), (1e-3, 'm'), (1e-6, 'µ'), (1e-9, 'n'))
PREFIXED = frozenset({'N', 'm', 'rad', 's', 'Hz', 'm/s'})
PLAIN = frozenset({'', '1'})

DIGITS, RAISED_DIGITS = '-0123456789', '⁻⁰¹²³⁴⁵⁶⁷⁸⁹'

MIN_SHARE = 1e-5
"""Smallest share that is printed."""

MAX_LOG = 600.0
"""Largest logarithm of an evidence that is counted: e^709 is the largest number."""

LONG_TIMES = ((172800.0, 86400.0, 'd'), (7200.0, 3600.0, 'h'), (1000.0, 60.0, 'min'))
"""Times [s] from which one is printed in another unit, that unit in seconds, and its sign."""


def quantity(value: float | None, unit: str = '', std: float | None = None,
             digits: int = 3) -> str:
    """'9.04 ± 0.03 kN'; a value without error (None or 0) has `digits`, no value is a dash."""
    if value is None or not math.isfinite(value):
        return '–'
    size = max(abs(value), abs(std or 0.0))
    factor, shown = 1.0, '' if unit in PLAIN else unit
    if unit == 'rad' and abs(value) >= math.radians(0.1):
        factor, shown = math.radians(1.0), '°'
    elif unit == 's' and size >= LONG_TIMES[-1][0]:
        _, factor, shown = next(one for one in LONG_TIMES if size >= one[0])
    elif unit in PREFIXED and size > 0.0:
        factor, prefix = next((pair for pair in PREFIXES if size >= pair[0] * (1.0 - 1e-12)),
                              PREFIXES[-1])
        shown = prefix + unit
    text = _with_error(value / factor, None if not std else std / factor, digits)
    return f'{text} {shown}'.strip()


def signed(value: float, unit: str = '') -> str:
    """A value with its sign: '+3.20 µm'."""
    return ('+' if value > 0.0 else '') + quantity(value, unit)


def compact(value: float | None, digits: int = 3) -> str:
    """A number without closing zeros: '0.5', '2000'; from a million on as '2 × 10⁷'."""
    if value is None or not math.isfinite(value):
        return '–'
    text = f'{float(f"{value:.{digits}g}"):g}'
    mantissa, _, power = text.partition('e')
    return f'{mantissa} × 10{superscript(int(power))}' if power else text


def span(low: float, high: float, unit: str = '', digits: int = 4) -> str:
    """'(1.27 to 1.33) × 10⁸ N/m^n': two numbers with one power of ten, which differ.

    Times of a clock, which need more digits, have no power: '1700000005 to 1700000008 s'.
    """
    size, apart = max(abs(low), abs(high)), abs(high - low)
    power = math.floor(math.log10(size)) if size and not 1e-2 <= size < 1e4 else 0
    needed = math.floor(math.log10(size / apart)) + 2 if 0.0 < apart < size else 0
    if needed > digits:
        digits, power = needed, 0 if 0 < power < needed else power
    words = f'{low / 10.0**power:.{digits}g} to {high / 10.0**power:.{digits}g}'
    text = f'({words}) × 10{superscript(power)}' if power else words
    return text if unit in PLAIN else f'{text} {unit}'


def percent(share: float | None, digits: int = 2) -> str:
    """A share as percent with a number of significant digits."""
    if share is None or not math.isfinite(share):
        return '–'
    if 0.0 < abs(share) < MIN_SHARE:
        return f'< {100.0 * MIN_SHARE:g} %'
    return f'{significant(100.0 * share, digits)} %'


def shares_in_words(shares: Mapping[str, float]) -> dict[str, str]:
    """Shares of a whole in percent, the largest first: whole numbers that add to 100.

    The largest remainders are rounded up. '> 99 %' and '< 1 %' stand for 100 and 0 that are not
    exact. Shares below half a percent are left out.
    """
    order = sorted(shares, key=lambda name: -shares[name])
    exact = {name: round(100.0 * shares[name], 6) for name in order}
    whole = {name: math.floor(exact[name]) for name in order}
    missing = round(sum(exact.values())) - sum(whole.values())
    for name in sorted(order, key=lambda name: whole[name] - exact[name])[:missing]:
        whole[name] += 1
    words = {}
    for name in order:
        if shares[name] >= 0.005:
            is_exact = exact[name] in (0.0, 100.0)
            words[name] = ('> 99 %' if whole[name] == 100 and not is_exact else
                           '< 1 %' if whole[name] == 0 and not is_exact else f'{whole[name]} %')
    return words


def remainder_words(rest: Mapping[str, Any]) -> str:
    """'static_50, delta_y, along load: 0.31 µm rms, 0.4 % of range, 2.5 × noise'."""
    size = quantity(rest.get('size'), rest.get('unit') or '', digits=2)
    share, times = percent(rest['share_of_range']), compact(rest['times_noise'], 2)
    along = f', along {rest["along"]}' if rest['along'] else ''
    return (f'{rest["run"]}, {rest["channel"]}{along}: {size} rms, {share} of range, {times} × '
            'noise')


def signed_percent(share: float, std: float | None = None, *, is_signed: bool = True) -> str:
    """'+3.0 ± 0.2 %': a share with its error, and with a sign where both signs are possible."""
    sign = '+' if is_signed and share > 0.0 else ''
    return f'{sign}{_with_error(100.0 * share, None if not std else 100.0 * std, 3)} %'


def probability(value: float | None) -> str:
    """A p-value: two digits, or that it is too small to matter how small."""
    if value is None or not math.isfinite(value):
        return '–'
    if value < 1e-12:
        return '< 10⁻¹²'
    return f'{value:.2f}' if value >= 0.01 else compact(value, 1)


def superscript(power: int) -> str:
    """A whole number as an exponent of ten."""
    return str(power).translate(str.maketrans(DIGITS, RAISED_DIGITS))


def significant(value: float, digits: int) -> str:
    """A number in plain notation with a number of significant digits."""
    if value == 0.0:
        return '0'
    places = max(0, digits - 1 - math.floor(math.log10(abs(value))))
    return f'{value:.{places}f}'


def _with_error(value: float, std: float | None, digits: int) -> str:
    size = max(abs(value), abs(std or 0.0))
    exponent = math.floor(math.log10(size)) if size >= 1e4 or 0.0 < size < 1e-2 else 0
    value /= 10.0**exponent
    if std is None:
        text = significant(value, digits)
    else:
        std /= 10.0**exponent
        places = min(6, max(0, 1 - math.floor(math.log10(std))))
        text = f'{value:.{places}f} ± {std:.{places}f}'
        text = f'({text})' if exponent else text
    return f'{text} × 10{superscript(exponent)}' if exponent else text


def finite_json(value: Any) -> Any:
    """The same document with JSON numbers: infinite and undefined become null."""
    if isinstance(value, dict):
        return {key: finite_json(entry) for key, entry in value.items()}
    if isinstance(value, (list, tuple)):
        return [finite_json(entry) for entry in value]
    if isinstance(value, (bool, np.bool_)):
        return bool(value)
    if isinstance(value, (float, np.floating)):
        return float(value) if math.isfinite(value) else None
    if isinstance(value, np.integer):
        return int(value)
    return value


VERDICT_WORDS = {
    'none': 'these data show no cause', 'named': 'the cause is identified',
    'ambiguous': 'several causes explain the misfit',
    'unknown': 'no known cause explains the misfit'}
"""A verdict in words: console, report, and the page of any simulator."""


def verdict_line(verdict: str) -> str:
    """The verdict and what it means."""
    return f'verdict: {verdict} ({VERDICT_WORDS[verdict]})'


MATERIAL = 1e-3
"""Share of a channel's range below which a misfit is immaterial."""

CHANCE = 0.01
"""Probability above which a finding counts as chance."""

WIDTH_95 = 1.959963984540054
"""Half width of a 95 % interval in standard deviations of a normal distribution."""

GOOD = 2.0
"""A misfit below this multiple of the noise floor is as good as the measurement."""

MAX_COMPARISON_ERROR = 2.0
"""Largest comparison error over validation uncertainty (ASME V&V 20) without a model error."""

MIN_RATING = 0.8
"""Smallest ISO 18571 rating of a good curve."""


def allowed_misfit(noise_floor: float | None, sound: float | None = None,
                   material: float = MATERIAL) -> float:
    """Largest misfit, as a share of range, that noise and a sound ring's small errors allow."""
    return max(GOOD * math.hypot(noise_floor or 0.0, sound or 0.0), material)


def is_left(p_value: float | None, share_of_range: float | None) -> bool:
    """Whether a part of the misfit is neither chance nor too small to matter."""
    return (p_value is not None and p_value < CHANCE
            and share_of_range is not None and share_of_range >= MATERIAL)


def lowered(title: str) -> str:
    """A title in the form for the middle of a sentence."""
    return title[:1].lower() + title[1:] if title[1:2].islower() else title


MAX_REASONS = 3
"""Reasons that one line states: more of them are not read."""


def first_of(reasons: Sequence[str], separator: str = '; ') -> str:
    """The first reasons joined, each once, and how many more there are."""
    reasons = list(dict.fromkeys(reasons))
    more = len(reasons) - MAX_REASONS
    return separator.join(reasons[:MAX_REASONS]) + (f'{separator}and {more} more' * (more > 0))


def own_names(names: Iterable[str]) -> list[str]:
    """The names in their order; the second of one name becomes 'static_50 (2)', and so on."""
    count, own = Counter[str](), []
    for name in names:
        count[name] += 1
        own.append(name if count[name] == 1 else f'{name} ({count[name]})')
    return own


def told_once(notes: Iterable[tuple[str, str]]) -> list[str]:
    """Each note once, after the names of all runs that have it; notes: name and text."""
    runs: dict[str, list[str]] = {}
    for name, text in notes:
        runs.setdefault(text, []).append(name)
    return [f'{", ".join(names)}: {text}' for text, names in runs.items()]
