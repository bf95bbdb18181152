"""Claims about the figures of runs with a few samples."""

from dataclasses import replace

from documents import run_curves
import pytest

from saddlering_ros.pages.charts import draw
from saddlering_ros.report.figures import residuals


@pytest.mark.filterwarnings('error')
@pytest.mark.parametrize(('holds', 'panels'), [(2, 3), (3, 3), (4, 4)])
def test_a_run_too_short_for_a_spectrum_is_drawn_without_it(tmp_path, holds, panels):
    run = run_curves()
    shown = {name: getattr(run, name)[..., :holds] for name in (
        'width', 'time', 'load', 'direction', 'measured', 'before', 'after')}
    chart = residuals(replace(run, **shown))
    assert max(panel.column for panel in chart.panels) + 1 == chart.columns == panels
    draw(chart).savefig(tmp_path / 'drawn.png')
