"""The answer of a goal in the words that console and report print for the same result."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, TYPE_CHECKING

if TYPE_CHECKING:
    from saddlering_ros.diagnosis.wording import VerdictDocument


@dataclass(frozen=True)
class Answer:
    """Words of a result; verdict and title are empty for an identification."""

    verdict: str = ''
    title: str = ''
    words: str = ''
    lines: tuple[str, ...] = ()


def diagnosis_answer(document: VerdictDocument) -> Answer:
    """A verdict: its words, the headline, the next test and the misfit reduction."""
    # The words need the catalogue; the page is served before it is loaded.
    from saddlering_ros.diagnosis.wording import gain_sentence, headline
    from saddlering_ros.quantities import VERDICT_WORDS

    verdict, following = document['verdict'], document.get('next_test')
    lines = (f'Next test: {following}' if following else '', gain_sentence(document))
    return Answer(verdict, f'Verdict: {verdict} – {VERDICT_WORDS[verdict]}', headline(document),
                  tuple(filter(None, lines)))


def identification_answer(report: Mapping[str, Any], words: str) -> Answer:
    """An identification: the message of the server, and a line for each parameter."""
    from saddlering_ros.identification.result import parameter_words

    return Answer(words=words, lines=tuple(
        parameter_words(name, item) for name, item in report['parameters'].items()))
