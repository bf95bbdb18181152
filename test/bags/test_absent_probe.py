"""A radial probe that the rig does not have costs the parity, and every result states it."""

from dataclasses import replace

import numpy as np
import pytest

from saddlering_ros.bags.reader import bag_info, read_raw, read_run
from saddlering_ros.bags.write import write_bag
from saddlering_ros.errors import BagError
from saddlering_ros.files import share_directory
from saddlering_ros.record.batches import join, Samples
from saddlering_ros.record.displacement import (
    displacement_of_run,
    DisplacementStream,
    measured_rows,
    zero_of_run,
)
from saddlering_ros.record.record import TestMetadata
from saddlering_ros.record.topics import LOAD_TOPIC, PROBE_TOPICS
from saddlering_ros.rig import default_rig, load_rig, Rig, RigError

RIG = default_rig()


def without(probe: int, **changes: object) -> Rig:
    return replace(RIG, probes=replace(RIG.probes, absent=probe, **changes))


def written(recording, path, absent):
    """The recording as a bag of a rig without this probe."""
    return write_bag(
        path, TestMetadata('dynamic', 50.0), recording.stamps[LOAD_TOPIC],
        recording.values[LOAD_TOPIC], [recording.stamps[topic] for topic in PROBE_TOPICS],
        [recording.values[topic] for topic in PROBE_TOPICS], without(absent).probes)


def test_without_a_declaration_the_bag_is_refused_and_the_line_names_the_entry(tmp_path, moved):
    bag = written(moved[0], tmp_path / 'bag', 3)
    with pytest.raises(BagError, match=r'state rig\.probes\.absent: 3 in the rig file') as refused:
        read_run(bag, rig=RIG)
    assert '\n' not in str(refused.value)


@pytest.mark.parametrize(('absent', 'partner_polarity'), [(1, 1.0), (3, 1.0), (3, -1.0)])
def test_three_probes_measure_the_displacement_and_the_parity_is_unknown(
        tmp_path, moved, absent, partner_polarity):
    recording, motion = moved
    rig = without(absent)
    if partner_polarity < 0.0:
        rig = without(absent, polarity=(-1.0, 1.0, 1.0, 1.0))
        stamps, gap = recording.stamps[PROBE_TOPICS[0]], recording.values[PROBE_TOPICS[0]]
        recording = recording.changed(PROBE_TOPICS[0], stamps, 2e-3 - gap)
    bag = written(recording, tmp_path / 'bag', absent)
    run = read_run(bag, rig=rig)
    measured = displacement_of_run(rig, run)
    at_zero = slice(measured.zero.start, measured.zero.end)
    for name in ('delta_x', 'delta_y', 'gamma'):
        true = getattr(motion, name)
        np.testing.assert_allclose(
            getattr(measured.displacement, name), true - true[at_zero].mean(), atol=1e-9)
    assert np.isnan(measured.displacement.parity).all()
    published = measured_rows(rig, run, zero_of_run(rig, run), slice(None))
    assert np.array_equal(published.stamps, run.stamps)
    assert set(published.validity.tolist()) == {8}
    assert f'probe {absent} is absent' in ' '.join(run.notes)
    assert not any(PROBE_TOPICS[absent - 1] in note for note in run.notes)
    info = bag_info(bag, rig=rig)
    assert info.usable
    assert PROBE_TOPICS[absent - 1] not in [one.topic for one in info.topics]


def test_what_the_bag_holds_of_an_absent_probe_is_not_read(tmp_path, moved):
    recording, _ = moved
    whole = recording.write(tmp_path / 'whole')
    wild = recording.changed(PROBE_TOPICS[2], recording.stamps[LOAD_TOPIC],
                             np.full(len(recording.stamps[LOAD_TOPIC]), 1.9e-3))
    found, other = (displacement_of_run(without(3), read_run(bag, rig=without(3)))
                    for bag in (whole, wild.write(tmp_path / 'wild')))
    assert np.array_equal(found.d, other.d)
    np.testing.assert_allclose(found.d[2], -found.d[0], rtol=0.0, atol=1e-15)


def test_the_stream_gives_the_displacement_of_the_file_bit_for_bit(tmp_path, moved):
    rig = without(1)
    bag = written(moved[0], tmp_path / 'bag', 1)
    run = read_run(bag, rig=rig)
    offline = measured_rows(rig, run, zero_of_run(rig, run), slice(None))
    record = read_raw(bag, rig=rig)
    stream, parts = DisplacementStream(rig), []
    for first in range(0, len(record[LOAD_TOPIC]), 50):
        rows = slice(first, first + 50)
        load, *gaps = (Samples(record[name].stamps[rows], record[name].values[rows])
                       for name in (LOAD_TOPIC, *PROBE_TOPICS[1:]))
        parts.append(stream.push(load, gaps))
    live = join([part for part in [*parts, stream.flush()] if len(part)])
    _, ours, theirs = np.intersect1d(live.stamps, offline.stamps, return_indices=True)
    assert len(ours) > 0.9 * len(offline.stamps)
    np.testing.assert_array_equal(live.channels[:, ours], offline.channels[:, theirs])
    assert set(live.validity.tolist()) == {8}


@pytest.mark.parametrize(('stated', 'words'), [
    ('2', 'delta_y and gamma need both axial probes'), ('5', 'give 1 or 3'),
    ('true', 'give 1 or 3')])
def test_another_probe_cannot_be_absent(tmp_path, stated, words):
    shipped = share_directory() / 'config' / 'rig.yaml'
    file = tmp_path / 'rig.yaml'
    file.write_text(shipped.read_text().replace('absent: 0 ', f'absent: {stated} '))
    with pytest.raises(RigError, match=words) as refused:
        load_rig(file)
    assert str(file) in str(refused.value)
    assert '\n' not in str(refused.value)


def test_an_absent_probe_makes_no_other_ring():
    assert without(3).digest == RIG.digest
