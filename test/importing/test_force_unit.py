"""An import prints and draws the load in the unit of the rig file."""

from pathlib import Path

from matplotlib.figure import Figure
import pytest

from saddlering_ros.cli.main import main
from saddlering_ros.rig import shipped_rig_file

DATA = Path(__file__).resolve().parents[2] / 'docs' / 'data'


@pytest.mark.parametrize('unit', ['t', 'kN'])
def test_loads_of_an_import_are_in_the_unit_of_the_rig_file(tmp_path, monkeypatch, capsys, unit):
    rig = tmp_path / 'rig.yaml'
    text = shipped_rig_file().read_text()
    rig.write_text(text.replace('force_unit: t ', f'force_unit: {unit} '))
    labels, save = [], Figure.savefig

    def noted(figure, *args, **options):
        labels.append(figure.axes[0].get_ylabel())
        return save(figure, *args, **options)

    monkeypatch.setattr(Figure, 'savefig', noted)
    assert main(['import', str(DATA / 'dynamic_30.csv'), '--map',
                 str(DATA / 'map_dynamic_30.yaml'), '--rig', str(rig),
                 '--out', str(tmp_path / 'bag'), '--preview', str(tmp_path / 'a.png')]) == 0
    line = next(line for line in capsys.readouterr().out.splitlines() if 'hydraulic_load' in line)
    assert line.split()[-1] == unit
    assert labels == [f'load [{unit}]']
