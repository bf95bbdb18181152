"""The picture of the same chart, drawn once for all tests of a run.

The pictures of a report take five seconds of processor time, and several tests write a report of
the same verdict.
"""

from collections.abc import Callable
import hashlib
from pathlib import Path
import pickle

from made_once import MadeOnce

from saddlering_ros.pages.charts import Chart

DRAWN = 'saddlering_ros.pages.html.drawn'
"""Where reports find the function that these tests replace."""


def drawn_once() -> Callable[[Chart], bytes]:
    """`drawn`, which gives the picture of its first chart for every other one, too."""
    from saddlering_ros.pages.html import draw, png
    pictures: list[bytes] = []

    def drawn(chart: Chart) -> bytes:
        if not pictures:
            pictures.append(png(draw(chart)))
        return pictures[0]
    return drawn


def shared_drawn(made: MadeOnce) -> Callable[[Chart], bytes]:
    """`drawn`, which draws each chart once."""
    from saddlering_ros.pages.html import draw, png

    def drawn(chart: Chart) -> bytes:
        def make(folder: Path) -> None:
            (folder / 'picture').write_bytes(png(draw(chart)))

        digest = hashlib.sha256(pickle.dumps(chart)).hexdigest()[:20]
        return (made.folder(f'pictures/{digest}', make) / 'picture').read_bytes()
    return drawn
