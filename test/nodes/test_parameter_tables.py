"""The page of the nodes says what their declarations say."""

from pathlib import Path

from saddlering_ros.ros.reference import MARKER, reference

PAGE = Path(__file__).parents[2] / 'docs' / 'nodes.md'


def test_the_parameters_in_the_docs_are_those_declared() -> None:
    head, marker, _ = PAGE.read_text().partition(MARKER)
    assert marker
    assert PAGE.read_text() == head + reference()
