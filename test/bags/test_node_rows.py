"""Commands give the rows of a bag that the live nodes give, degraded and refused ones alike."""

from dataclasses import replace
from itertools import pairwise
import json
from pathlib import Path

import numpy as np
import pytest

from saddlering_ros import rig
from saddlering_ros.bags.reader import read_raw, read_run
from saddlering_ros.cli.main import main
from saddlering_ros.record.batches import BRIDGED, DOUBTFUL_LOAD, join
from saddlering_ros.record.displacement import DisplacementStream, measured_rows, zero_of_run
from saddlering_ros.record.guard import Samples
from saddlering_ros.record.residual import SimulationStream
from saddlering_ros.record.topics import LOAD_TOPIC, PROBE_TOPICS
from saddlering_ros.rig import default_rig, load_rig, ParameterSet, TONNE, TRUE_TO_SCALE
from saddlering_ros.rig.parameter_file import RigError

RIG = default_rig()
NO_DELTA_Y, NO_GAMMA = 2, 4


def live(path: Path, pace: float = 0.1):
    """What ring_displacement publishes of a bag that is replayed, `pace` [s] at a time."""
    record = read_raw(path)
    stream, parts = DisplacementStream(RIG), []
    bounds = range(record.start, record.stop + int(pace * 1e9) + 1, int(pace * 1e9))
    for first, last in pairwise(bounds):
        def due(topic: str, first: int = first, last: int = last) -> Samples:
            raw = record[topic]
            rows = slice(*np.searchsorted(raw.stamps, [first, last]))
            return Samples(raw.stamps[rows], raw.values[rows])
        parts.append(stream.push(due(LOAD_TOPIC), [due(name) for name in PROBE_TOPICS]))
    parts.append(stream.flush())
    return join([part for part in parts if len(part)])


def assert_equal_live_and_offline(path: Path) -> np.ndarray:
    """The validity of the rows, once both are found equal bit for bit."""
    run = read_run(path)
    samples = measured_rows(RIG, run, zero_of_run(RIG, run), slice(None))
    for pace in (0.1, 0.033, 20.0):
        found = live(path, pace)
        for name in ('stamps', 'channels', 'validity', 'zero_stamps', 'zero_loads',
                     'zero_durations'):
            assert np.array_equal(getattr(found, name), getattr(samples, name), equal_nan=True)
    return samples.validity


def silent(recording, topic: str, since: float, until: float = np.inf):
    """The recording without a topic's samples over some seconds."""
    stamps, values = recording.stamps[topic], recording.values[topic]
    time = (stamps - stamps[0]) * 1e-9
    kept = (time < since) | (time > until)
    return replace(recording, stamps={**recording.stamps, topic: stamps[kept]},
                   values={**recording.values, topic: values[kept]})


@pytest.mark.parametrize(('since', 'until'), [
    (3.0, np.inf), (2.0, 4.5), (2.0, 3.0), (2.0, 2.2), (-1.0, 2.5), (5.0, np.inf)])
def test_a_probe_that_is_silent_costs_the_same_live_and_offline(
        long_recording, tmp_path: Path, since: float, until: float) -> None:
    bag = silent(long_recording, PROBE_TOPICS[1], since, until).write(tmp_path / 'bag')
    validity = assert_equal_live_and_offline(bag)
    degraded = NO_DELTA_Y | NO_GAMMA
    is_silent = min(until, 6.0) - max(since, 0.0) > 0.25
    assert bool((validity == degraded).any()) == is_silent


def test_a_short_silence_before_the_zero_costs_its_rows_and_no_channel_of_the_zero(
        long_recording, tmp_path: Path) -> None:
    bag = silent(long_recording, PROBE_TOPICS[1], 0.2, 0.9).write(tmp_path / 'bag')
    assert set(assert_equal_live_and_offline(bag).tolist()) == {0}


def test_refused_readings_cost_the_same_live_and_offline(long_recording, tmp_path: Path) -> None:
    changed = long_recording
    for topic, row, value in ((LOAD_TOPIC, 500, 50.0 * TONNE), (LOAD_TOPIC, 700, -3e38),
                              (PROBE_TOPICS[0], 800, 1.0), (PROBE_TOPICS[3], 900, 1.4e-3),
                              (PROBE_TOPICS[3], 1200, 3e38), (LOAD_TOPIC, 1201, 3e38)):
        values = changed.values[topic].copy()
        values[row] = value
        changed = changed.changed(topic, values=values)
    validity = assert_equal_live_and_offline(changed.write(tmp_path / 'bag'))
    assert 3 <= (validity == BRIDGED).sum() <= 8
    assert set(validity.tolist()) == {0, BRIDGED}


def test_commands_print_what_is_not_known_and_write_it_as_such(long_recording, tmp_path, capsys):
    bag = silent(long_recording, PROBE_TOPICS[1], 2.0).write(tmp_path / 'bag')
    assert main(['displacement', str(bag), '--out', str(tmp_path / 'out.csv'),
                 '--json', str(tmp_path / 'out.json')]) == 0
    assert 'without delta_y' in capsys.readouterr().out
    head, *rows = (tmp_path / 'out.csv').read_text().splitlines()
    last = dict(zip(head.split(','), rows[-1].split(','), strict=True))
    assert (last['delta_y'], last['validity']) == ('nan', str(NO_DELTA_Y | NO_GAMMA))
    assert last['delta_x'] != 'nan'
    document = json.loads((tmp_path / 'out.json').read_text())
    assert document['channels']['delta_y']['last'] is None
    assert document['validity']['without delta_y'] == sum(row.endswith(',6') for row in rows)


@pytest.mark.parametrize('width', [0.6, 2.2])
def test_a_load_that_rolls_over_costs_the_same_live_and_offline(
        long_recording, tmp_path: Path, capsys, width: float) -> None:
    values = long_recording.values[LOAD_TOPIC].copy()
    values[1500:1600] -= width * RIG.full_scale_load
    bag = long_recording.changed(LOAD_TOPIC, values=values).write(tmp_path / 'bag')
    assert_equal_live_and_offline(bag)
    stream = SimulationStream(RIG, ParameterSet(TRUE_TO_SCALE), np.radians(50.0))
    raw = read_raw(bag)[LOAD_TOPIC]
    live_rows = stream.push(Samples(raw.stamps, raw.values))
    rig.write_parameters(tmp_path / 'p.yaml', ParameterSet(TRUE_TO_SCALE))
    assert main(['simulate', str(bag), '--params', str(tmp_path / 'p.yaml'),
                 '--out', str(tmp_path / 'out.csv')]) == 0
    assert ('rolls over' in capsys.readouterr().out) == (width < 1.0)
    rows = (tmp_path / 'out.csv').read_text().splitlines()[1:]
    offline = np.array([int(row.rpartition(',')[2]) for row in rows])
    assert np.array_equal(offline, live_rows.validity)
    assert np.count_nonzero(offline == DOUBTFUL_LOAD) == (100 if width < 1.0 else 0)
    run = read_run(bag).without_spikes()
    assert run.load.min() > -1e4, 'the fits go across it'


def test_sound_rows_alone_are_identified_from(long_recording, tmp_path: Path) -> None:
    values = long_recording.values[PROBE_TOPICS[0]].copy()
    values[800] = 1.0
    run = read_run(long_recording.changed(PROBE_TOPICS[0], values=values).write(tmp_path / 'bag'))
    kept = run.without_spikes()
    bridged = run.probe_marks > 0
    assert bridged.any()
    assert np.isnan(kept.gaps[:, bridged]).all()
    assert not kept.complete[bridged].any()


def test_the_fastest_change_of_the_hydraulics_is_of_the_rig_file(tmp_path: Path) -> None:
    from saddlering_ros.record.guard import load_limits, probe_limits

    text = (Path(__file__).parents[2] / 'config' / 'rig.yaml').read_text()
    slow = tmp_path / 'rig.yaml'
    slow.write_text(text.replace('full_scale_time: 0.1', 'full_scale_time: 10.0'))
    assert load_limits(load_rig(slow)).rate == load_limits(RIG).rate / 100.0
    assert probe_limits(load_rig(slow)).rate == probe_limits(RIG).rate / 100.0
    assert load_rig(slow).digest == RIG.digest
    slow.write_text(text.replace('full_scale_time: 0.1', 'full_scale_time: 0.0'))
    with pytest.raises(RigError, match='full_scale_time'):
        load_rig(slow)
