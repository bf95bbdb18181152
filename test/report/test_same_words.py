"""Console, report and live page print the same words for the same result."""

from html import unescape
import re

from documents import document
import pytest

from saddlering_ros.diagnosis.ring_wording import document_text
from saddlering_ros.identification.result import parameter_words
from saddlering_ros.live.commands import Job, with_diagnosis, with_identification
from saddlering_ros.quantities import VERDICT_WORDS
from saddlering_ros.report import chapters

OPEN = {'value': 1.27e8, 'unit': 'N/m^n', 'std': None, 'interval': None, 'pinned': False,
        'reason': 'the rollers may be unequal', 'at_bound': False}


def of_verdict(verdict):
    shape = {'shape': 'delta_x follows the load', 'channel': 'delta_x', 'coordinate': 'load',
             'share_of_range': 0.05}
    causes = {'unknown': [shape], 'none': []}
    titled = [{'title': 'Dry friction', **cause} for cause in document()['causes']]
    changes = {'causes': causes.get(verdict, titled)}
    return document(verdict, next_test='Load twice as fast.', **changes)


@pytest.mark.parametrize('verdict', VERDICT_WORDS)
def test_a_verdict_has_the_same_words_everywhere(verdict):
    said = of_verdict(verdict)
    answer = with_diagnosis(Job('goal'), said)
    console = document_text(said)
    banner = ' '.join(unescape(re.sub(r'<[^>]+>', ' ', chapters.verdict_banner(said))).split())
    for place in (console, banner, f'{answer.title} {answer.words} '
                  + ' '.join(answer.lines)):
        assert VERDICT_WORDS[verdict] in place
        assert answer.words in place
        assert 'Load twice as fast.' in place
    for line in answer.lines[1:]:
        assert line in console
        assert line in banner


def test_an_open_parameter_has_the_same_words_on_the_live_page():
    answer = with_identification(Job('goal', words='identified'), {'parameters': {'K1': OPEN}})
    assert answer.lines == [parameter_words('K1', OPEN)]
    assert answer.lines[0].startswith('K1: not determined by these data (best known 1.27')
