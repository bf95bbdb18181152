"""The page of the nodes holds what the registry and the declarations say."""

from pathlib import Path

from saddlering_ros.ros.reference import MARKER, rewritten, TABLE

PAGE = Path(__file__).parents[2] / 'docs' / 'nodes.md'


def test_nodes_and_parameters_in_the_docs_are_those_declared() -> None:
    page = PAGE.read_text()
    assert MARKER in page
    assert TABLE in page
    assert page == rewritten(page)
