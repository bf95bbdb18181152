"""Records that read well and are not what they seem: units, kind, zero, repeats, spikes."""

from dataclasses import replace
import math
from pathlib import Path
import re
import shutil
import time

import numpy as np
import pytest

from saddlering_ros.bags.reader import bag_info, read_raw, read_run
from saddlering_ros.bags.wire import DISPLACEMENT_TYPE, encode
from saddlering_ros.bags.write import BagWriter, MessageBlock, messages_of, write_bag
from saddlering_ros.doubts import on_rig, readings
from saddlering_ros.doubts.comparison import refuse_repeats
from saddlering_ros.doubts.on_rig import line_findings, parity_findings, rig_findings
from saddlering_ros.doubts.units import check_probe_unit
from saddlering_ros.doubts.wiring import exchange_findings, wiring_findings
from saddlering_ros.errors import BagError
from saddlering_ros.record.batches import SECOND
from saddlering_ros.record.record import Record, TestMetadata
from saddlering_ros.record.topics import LOAD_TOPIC, PROBE_TOPICS, TOPICS
from saddlering_ros.rig import default_rig, TONNE

RIG = default_rig()
SPANS = [(0.0, 2e-3)] * 4
TIME = np.arange(0.0, 10.0, 0.01)
RAMP = RIG.preload + 24.0 * TONNE * np.clip(1.2 - np.abs(TIME - 5.0) / 2.5, 0.0, 1.0)


@pytest.mark.parametrize(('degrees', 'note', 'said'), [
    (50.0, '', 0), (70.0, '', 1), (70.0, 'the recorder said so', 0), (math.nan, '', 0)])
def test_an_older_bag_whose_nodes_had_another_elevation_has_a_note(
        recording, tmp_path, degrees, note, said):
    text = Path(__file__).parents[2] / 'saddlering_interfaces' / 'msg' / 'RingDisplacement.msg'
    topics = {topic: TOPICS[topic].type for topic in recording.stamps}
    stamps = recording.stamps[LOAD_TOPIC]
    with BagWriter(tmp_path / 'bag', topics | {'/ring/displacement': DISPLACEMENT_TYPE},
                   recording.facts | {'recorder_note': note},
                   definitions={DISPLACEMENT_TYPE: text.read_text()}) as writer:
        writer.write([
            *(messages_of(TOPICS[topic], recording.stamps[topic], recording.values[topic],
                          (0.0, 2e-3)) for topic in topics),
            MessageBlock('/ring/displacement', stamps, encode(DISPLACEMENT_TYPE, 'ring', stamps, {
                'elevation': math.radians(degrees)}))])
    words = 'the bag states 50 deg, and nodes meanwhile had another: /ring/displacement (70.00 deg'
    assert sum(words in one for one in bag_info(tmp_path / 'bag').notes) == said


def test_the_clocks_of_the_topics_of_a_bag_are_compared_once(recording, tmp_path, monkeypatch):
    compared = []
    own = readings.other_clocks
    for module in (readings, on_rig):
        monkeypatch.setattr(module, 'other_clocks', lambda *given: compared.append(given) or own(
            *given), raising=False)
    read_run(recording.write(tmp_path / 'bag'), rig=RIG)
    assert len(compared) == 1


@pytest.mark.parametrize(('begin', 'details', 'words'), [
    (math.inf, {}, 'later than the clock of this machine'),
    (5 * SECOND, {}, 'begins at 1970-01-01 00:00:05 UTC: the clock of the recorder was not set'),
    (5 * SECOND, {'import_sources': 'a.csv'}, ''),  # a time without a date
    (-math.inf, {}, '')])
def test_a_date_that_no_test_has_is_noted(recording, tmp_path, begin, details, words):
    """Campaigns and histories order tests by it."""
    if math.isinf(begin):
        begin = time.time_ns() + round(math.copysign(3600, begin)) * SECOND
    shift = begin - min(int(stamps[0]) for stamps in recording.stamps.values())
    bag = write_bag(
        tmp_path / 'bag', TestMetadata('dynamic', 50.0, details=details),
        recording.stamps[LOAD_TOPIC] + shift, recording.values[LOAD_TOPIC],
        [recording.stamps[topic] + shift for topic in PROBE_TOPICS],
        [recording.values[topic] for topic in PROBE_TOPICS], RIG.probes)
    noted = [note for note in bag_info(bag).notes if 'clock of' in note]
    assert len(noted) == bool(words)
    assert all(words in note for note in noted)


@pytest.mark.parametrize('seed', range(8))
def test_probes_none_of_which_moves_with_the_load_have_no_polarity(seed):
    """Noise was 'wrong polarity: µm per t +0.00 where - is due', or nothing, by its signs."""
    gaps = 1e-3 + np.random.default_rng(seed).normal(0.0, 3e-7, (4, len(RAMP)))
    found, = map(str, wiring_findings(RIG, math.radians(50.0), RAMP, gaps))
    assert found.startswith('no probe follows the load: over 24.0 t the readings change by ')
    assert 'noise' in found


def test_a_sound_ramp_has_no_note():
    assert rig_findings(RIG, 'dynamic', TIME, RAMP, SPANS) == []


@pytest.mark.parametrize(('newtons', 'metres', 'unit'), [
    (9.80665, 1.0, 'kgf'), (10.0, 1.0, 'daN'), (4.4482216, 1.0, 'lbf'), (1.0, 0.0254, 'inches'),
    (1.0, 0.3048, 'feet')])
def test_a_load_or_a_span_in_another_unit_looks_like_it(newtons, metres, unit):
    found = rig_findings(RIG, 'dynamic', TIME, RAMP / newtons, [(0.0, 2e-3 / metres)] * 4)
    assert len(found) == (1 if metres == 1.0 else 4)
    assert all('looks like' in note and unit in note.units for note in found)
    assert all(note.units in note for note in found)


@pytest.mark.filterwarnings('error')
@pytest.mark.parametrize(('metres', 'unit'), [
    (1e-3, 'millimetres'), (0.0254, 'inches'), (0.3048, 'feet'), (1e-2, 'centimetres'),
    (25.4e-6, 'mils')])
def test_readings_outside_of_their_span_look_like_a_unit(recording, tmp_path, metres, unit):
    for topic in PROBE_TOPICS:
        recording = recording.changed(topic, values=recording.values[topic] / metres)
    info = bag_info(recording.write(tmp_path / 'bag'))
    assert f'look like {unit}' in ' '.join([*info.problems, *info.notes])


@pytest.mark.parametrize('low', [-1e-3, -2e-3])
def test_a_span_about_zero_shows_a_unit_too(low):
    with pytest.raises(BagError, match='look like millimetres'):
        check_probe_unit('probe', np.full(9, 0.4), low, 1e-3)


@pytest.mark.parametrize(('load', 'words'), [
    (1.5 * RAMP, 'the load reaches 36.8 t and the full scale is 25.0 t'),
    (0.05 * RAMP, 'the load reaches 1.23 t at most and the full scale is 25.0 t'),
    (RAMP - RIG.preload, 'the zero, at 0.00 t, is below the preload (0.50 t): the load was tared'),
    (np.maximum(RAMP, 15.0 * TONNE),
     'the record starts at 15.0 t, which is not near the preload (0.5 t)'),
    (RAMP[np.r_[500:1000, 0:500]], 'the load was 24.5 t before its first rest near the preload')],
    ids=['high', 'low', 'tared', 'late', 'zero late'])
def test_a_load_far_from_the_full_scale_or_from_far_off_the_preload_is_noted(load, words):
    (note,) = map(str, rig_findings(RIG, 'dynamic', TIME, load, SPANS))
    assert note.startswith(words)


def test_a_logger_too_slow_for_the_zero_is_noted():
    (note,) = map(str, rig_findings(RIG, 'dynamic', TIME[::20], RAMP[::20], SPANS))
    assert note.startswith('no half second of a steady load near the preload (0.5 t) has 5 read')


@pytest.mark.parametrize(('stated', 'is_doubtful'), [
    (0.8727, True), (0.436332, True), (-0.0873, True), (0.0, False), (0.5, False), (1.0, False),
    (50.0, False)])
def test_an_elevation_in_radians_looks_like_it(tmp_path, recording, stated, is_doubtful):
    bag = replace(recording, facts=recording.facts | {'elevation_deg': str(stated)}).write(
        tmp_path / 'bag')
    notes = ' '.join(bag_info(bag).notes)
    assert ('looks like radians' in notes) == is_doubtful
    if is_doubtful:
        assert f'give --elevation {round(math.degrees(stated))}' in notes


@pytest.mark.filterwarnings('error')
def test_a_load_cell_that_stands_still_is_noted(tmp_path, recording):
    still = np.full_like(recording.values[LOAD_TOPIC], RIG.preload)
    bag = recording.changed(LOAD_TOPIC, values=still).write(tmp_path / 'bag')
    assert 'load: the reading never changes' in bag_info(bag).notes


@pytest.mark.parametrize(('seconds', 'is_doubtful'), [(0.2, True), (-1.0, True), (0.01, False)])
def test_probes_stamped_by_another_clock_are_noted(tmp_path, recording, seconds, is_doubtful):
    for topic in PROBE_TOPICS:
        stamps = recording.stamps[topic] + int(1e9 * seconds)
        recording = recording.changed(topic, stamps=stamps)
    notes = ' '.join(bag_info(recording.write(tmp_path / 'bag')).notes)
    side = 'earlier' if seconds > 0.0 else 'later'
    words = f'{LOAD_TOPIC}: begins and ends {abs(seconds):.3g} s {side} than the others'
    assert (words in notes) == is_doubtful


@pytest.mark.parametrize('probe', range(4))
def test_one_probe_of_another_clock_is_noted_and_no_cable_nor_elevation_is_blamed(
        tmp_path, campaign, probe):
    """Probes of the shipped bags are recorded for two periods before and after the load."""
    bag, = campaign(runs=['dynamic_50_fast'])
    raw, topic = read_raw(bag), PROBE_TOPICS[probe]
    late = {name: raw[name].stamps + 500_000_000 * (name == topic) for name in PROBE_TOPICS}
    write_bag(tmp_path / 'bag', TestMetadata('dynamic', 50.0), raw[LOAD_TOPIC].stamps,
              raw[LOAD_TOPIC].values, list(late.values()),
              [raw[name].values for name in PROBE_TOPICS], RIG.probes)
    notes = bag_info(tmp_path / 'bag').notes
    assert f'{topic}: begins and ends 0.5 s later than the others' in ' '.join(notes)
    assert not [note for note in notes if 'swapped' in note or 'elevation' in note]


@pytest.mark.parametrize('topic', [LOAD_TOPIC, PROBE_TOPICS[1]])
def test_a_clock_that_is_set_during_the_test_is_told_from_lost_samples(
        tmp_path, recording, topic):
    stamps, values = recording.stamps[topic], recording.values[topic]
    set_ahead = stamps + 300_000_000 * (np.arange(len(stamps)) > 400)
    lost = np.delete(np.arange(len(stamps)), np.s_[400:550])
    for found, is_set in ((recording.changed(topic, set_ahead), True),
                          (recording.changed(topic, stamps[lost], values[lost]), False)):
        notes = ' '.join(bag_info(found.write(tmp_path / str(is_set))).notes)
        assert (f'{topic}: stamps leap by 0.3 s, and end so much later' in notes) == is_set
        assert '1 gap in the stamps' in notes


def test_a_late_probe_that_would_mirror_another_is_not_taken_for_swapped_channels():
    late = np.interp(TIME - 0.5, TIME, RAMP)
    motion = 4e-10 * np.array([RAMP, 0.9 * RAMP, -late, -RAMP])
    noise = np.random.default_rng(0).normal(0.0, 3e-7, motion.shape)
    found = wiring_findings(RIG, 0.0, RAMP, 1e-3 + motion + noise)
    assert 'swapped' not in ' '.join(map(str, found))


@pytest.mark.parametrize(('factor', 'is_told'), [(1e-3, True), (0.01, True), (0.05, False)])
def test_probes_that_move_less_than_those_of_the_stiffest_ring_are_told(factor, is_told):
    """Gaps in mm that a map calls um: `identify` fitted them, and said nothing of the unit."""
    motion = 4e-10 * factor * np.array([RAMP, 1.5 * RAMP, -RAMP, -1.5 * RAMP])
    noise = np.random.default_rng(0).normal(0.0, 3e-7 * factor, motion.shape)
    found = ' '.join(map(str, wiring_findings(RIG, 0.0, RAMP, factor * 1e-3 + motion + noise)))
    assert ('even the stiffest ring of the bounds' in found) == is_told


@pytest.mark.parametrize(('last', 'is_told'), [(700, True), (420, False)])
def test_a_load_that_stands_still_while_the_probes_move_is_told(last, is_told):
    motion = 4e-10 * np.array([RAMP, RAMP, -RAMP, -RAMP])
    noise = np.random.default_rng(0).normal(0.0, 3e-7, motion.shape)
    load = np.where((np.arange(len(RAMP)) >= 350) & (np.arange(len(RAMP)) < last),
                    RAMP[350], RAMP)
    found = ' '.join(map(str, wiring_findings(RIG, 0.0, load, 1e-3 + motion + noise)))
    assert ('the load cell or its channel is stuck' in found) == is_told


def test_probes_that_begin_later_and_end_with_the_load_are_not_noted(tmp_path, recording):
    for topic in PROBE_TOPICS:
        recording = recording.changed(topic, stamps=recording.stamps[topic][200:],
                                      values=recording.values[topic][200:])
    assert 'begins and ends' not in ' '.join(bag_info(recording.write(tmp_path / 'bag')).notes)


def test_a_load_that_ends_before_the_probes_is_noted(tmp_path, recording):
    part = len(recording.stamps[LOAD_TOPIC]) // 4
    short = recording.changed(LOAD_TOPIC, recording.stamps[LOAD_TOPIC][:part],
                              recording.values[LOAD_TOPIC][:part])
    notes = ' '.join(bag_info(short.write(tmp_path / 'bag')).notes)
    assert f'{LOAD_TOPIC}: lasts ' in notes
    assert 's less than the others, whose readings before and after it are not used' in notes


@pytest.mark.parametrize(('cables', 'words'), [
    ((0, 1, 3, 2), 'channels of probes 3 and 4 look swapped: 1 and 4 mirror each other'),
    ((1, 0, 2, 3), 'channels of probes 1 and 2 look swapped: 2 and 3 mirror each other'),
    ((1, 0, 3, 2), 'channels of probes 1 and 3 look swapped with those of 2 and 4'),
    ((0, 1, 2, 1), 'probes 2 and 4 have the same readings throughout'),
    ((0, 1, 2, 3), '')])
def test_swapped_or_copied_channels_are_named_with_what_to_correct(cables, words):
    load = np.linspace(0.0, 24.0 * TONNE, 400)
    slopes = np.array([4.0, 3.0, -4.0, -1.5])[list(cables)] * 1e-10
    notes = [*map(str, wiring_findings(RIG, math.radians(60.0), load,
                                       1e-3 + slopes[:, None] * load))]
    assert [note[:len(words)] for note in notes] == ([words] if words else [])


def test_the_mirror_of_a_probe_that_faces_an_absent_one_is_no_copy_at_opposite_polarities():
    load = np.linspace(0.0, 24.0 * TONNE, 400)
    rig = replace(RIG, probes=replace(RIG.probes, polarity=(-1, 1, 1, 1), absent=3))
    slopes = np.array([-4.0, 3.0, -4.0, -1.5])[:, None] * 1e-10
    assert not wiring_findings(rig, math.radians(60.0), load, 1e-3 + slopes * load)


def test_steps_that_are_held_look_like_a_static_test():
    time = np.arange(0.0, 60.0, 0.02)
    levels = TONNE * np.concatenate([np.arange(1, 11), np.arange(9, 0, -1)])
    random = np.random.default_rng(0)
    load = np.interp(time % 3.0, [0.0, 0.5], [0.0, 1.0])
    held = levels[np.minimum((time / 3.0).astype(int), 18)]
    before = np.concatenate([[RIG.preload], levels])[np.minimum((time / 3.0).astype(int), 18)]
    load = before + (held - before) * load + random.normal(0.0, 50.0, time.size)
    load[time > 57.0] = TONNE
    notes = [*map(str, rig_findings(RIG, 'dynamic', time, load, SPANS))]
    assert [note for note in notes if 'looks like a static test' in note]
    others = [*map(str, rig_findings(RIG, 'static', time, load, SPANS))]
    assert not [note for note in others if 'static' in note]


def run(seed=0, start=0):
    random = np.random.default_rng(seed)
    load = RAMP + random.normal(0.0, 50.0, TIME.size)
    gaps = 1e-3 + random.normal(0.0, 3e-7, (4, TIME.size))
    stamps = (1e9 * TIME).astype(np.int64) + start
    return Record('a', Path(f'bag_{seed}_{start}'), 'dynamic', math.radians(50.0), '', '',
                  stamps, TIME, load, gaps)


def test_the_same_recording_under_another_name_and_a_part_of_it_are_refused():
    first = run()
    refuse_repeats([first, run(seed=1)])
    with pytest.raises(BagError, match='holds the same recording as'):
        refuse_repeats([first, replace(first, path=Path('copy'))])
    part = replace(first, path=Path('part'), stamps=first.stamps[300:], load=first.load[300:],
                   time=first.time[300:], gaps=first.gaps[:, 300:])
    with pytest.raises(BagError, match='is fitted: hold out another recording'):
        refuse_repeats([first], [part])


def test_a_run_that_shares_a_part_of_another_has_a_note():
    first, second = run(), run(seed=1, start=int(1e9 * TIME[700]))
    second.stamps[:300] = first.stamps[700:]
    refuse_repeats([first, second])
    assert second.notes == []
    load, gaps = second.load.copy(), second.gaps.copy()
    load[:300], gaps[:, :300] = first.load[700:], first.gaps[:, 700:]
    overlapping = replace(second, load=load, gaps=gaps)
    refuse_repeats([first, overlapping])
    assert [note.partition(' samples')[0] for note in overlapping.notes] == [
        f'300 of its {len(load)}']


def test_a_copy_with_new_stamps_and_a_part_of_it_are_the_same_recording():
    first = run()
    for rows in (slice(None), slice(100, 800)):
        other = replace(
            first, path=Path('anew'), stamps=first.stamps[rows] + 3600 * 10**9,
            load=first.load[rows], time=first.time[rows], gaps=first.gaps[:, rows])
        with pytest.raises(BagError, match='holds the same recording as'):
            refuse_repeats([first, other])
    refuse_repeats([first, replace(run(seed=1), load=first.load, path=Path('same course'))])


def test_a_copied_bag_with_other_log_times_is_the_same_recording(tmp_path, recording):
    first = read_run(recording.write(tmp_path / 'one'))
    second = read_run(recording.write(tmp_path / 'two', log_delay=5_000_000))
    with pytest.raises(BagError, match='same recording'):
        refuse_repeats([first, second])


def test_a_spike_costs_itself_and_is_counted(tmp_path, recording):
    load = recording.values[LOAD_TOPIC].copy()
    load[400] += 50.0 * TONNE
    gap = recording.values[PROBE_TOPICS[2]].copy()
    gap[600] += 2e-4
    struck = recording.changed(LOAD_TOPIC, values=load).changed(PROBE_TOPICS[2], values=gap)
    seen = read_run(struck.write(tmp_path / 'bag'))
    sound = read_run(recording.write(tmp_path / 'sound'))
    kept = seen.without_spikes()
    (of_load,) = (note for note in seen.notes if note.startswith(f'{LOAD_TOPIC}: 1 sample is'))
    assert '(1 impossible: limits -24.5 kN and 368 kN)' in of_load
    assert sum('(1 leap of reading: limit 20.0 µm + ' in note for note in seen.notes) == 1
    assert sum('1 reading is a spike' in note for note in seen.notes) == 1
    assert np.array_equal(seen.stamps, np.delete(sound.stamps, 400))
    lost = np.isnan(kept.gaps[2]) & ~np.isnan(seen.gaps[2])
    assert seen.stamps[lost].tolist() in (sound.stamps[599:601].tolist(),
                                          sound.stamps[600:602].tolist())
    assert bag_info(tmp_path / 'bag').topics[3].spikes == 1


def test_two_tests_in_one_folder_are_refused(tmp_path, recording):
    bag = recording.write(tmp_path / 'bag')
    later = {name: stamps + 10**11 for name, stamps in recording.stamps.items()}
    other = replace(recording, stamps=later, facts=recording.facts | {
        'test': 'static', 'elevation_deg': '70'})
    second = other.write(tmp_path / 'other')
    shutil.copy(second / 'other_0.mcap', bag / 'bag_1.mcap')
    (bag / 'metadata.yaml').unlink()
    with pytest.raises(BagError, match='these are two tests'):
        read_run(bag)


def parity_of(share, noise=3e-7, load=None):
    """Gaps of a rigid ring with a share of probe 2 in the readings of probe 1."""
    random = np.random.default_rng(0)
    motion = 100e-6 * ((RAMP if load is None else load) - RIG.preload) / RIG.full_scale_load
    gaps = 1e-3 + np.outer([0.5, 1.0, -0.5, -1.0], motion)
    gaps[0] += share * motion
    return gaps + random.normal(0.0, noise, gaps.shape)


def test_the_slow_noise_of_an_hour_of_cycles_is_no_drift_of_a_probe():
    # Means over minutes hide the motion of the ring, and show the noise of slow times.
    phase = np.linspace(0.0, 231.3, 48_000)
    load = TONNE * (0.5 + 24.5 * np.abs(2.0 * (phase % 1.0) - 1.0))
    gaps = parity_of(0.0, load=load)
    gaps[0] += 150e-9 * np.sin(2.0 * np.pi * phase / 100.0)
    assert parity_findings(RIG, load, gaps) == []
    gaps[0] += 2e-6 * np.sin(2.0 * np.pi * phase / 100.0)
    assert len(parity_findings(RIG, load, gaps)) == 1


def test_cross_talk_of_two_percent_moves_the_parity_and_noise_does_not():
    assert parity_findings(RIG, RAMP, parity_of(0.0)) == []
    assert parity_findings(RIG, RAMP, parity_of(0.0, noise=1e-6)) == []
    (note,) = map(str, parity_findings(RIG, RAMP, parity_of(0.02)))
    assert re.search(r'follows the load by 9\d\d nm', note)


def test_a_clock_of_one_radial_probe_moves_the_parity_while_the_load_moves():
    # D2 was 4.6 times too large, with an interval of 0.4 %, and no note.
    gaps = parity_of(0.0)
    gaps[2] = np.interp(TIME - 0.5, TIME, gaps[2])
    (note,) = map(str, parity_findings(RIG, RAMP, gaps))
    assert 'not with the load' in note
    assert 'a clock, a delay or a drift of one of them' in note


@pytest.mark.parametrize('sizes', [(25, 25), (10, 40)])
def test_stamps_by_arrival_of_a_block_are_told_from_recordings_that_do_not_overlap(
        tmp_path, recording, sizes):
    changed = recording
    for number, topic in enumerate((LOAD_TOPIC, *PROBE_TOPICS)):
        count = recording.stamps[topic].size
        block = np.repeat(np.arange(count), np.resize(sizes, count))[:count]
        late = (block + 1) * 50_000_000 + 3_000_000 * number
        within = np.arange(count) - np.searchsorted(block, block)
        changed = changed.changed(
            topic, stamps=recording.stamps[topic][0] + late + within * 10_000)
    with pytest.raises(BagError, match=r'come in blocks, 49.. ms apart.* stamp each sample when'):
        read_run(changed.write(tmp_path / 'bag'))


def test_an_oscillation_of_the_parity_is_noted_with_its_frequency_and_noise_is_not():
    gaps = parity_of(0.02)
    assert line_findings(RIG, 10.0, RAMP, gaps) == []
    folded = gaps + 2e-6 * np.sin(2.0 * np.pi * 1.7 * TIME)
    (note,) = map(str, line_findings(RIG, 10.0, RAMP, folded))
    assert 'oscillates by 2.0 µm at 1.70 Hz' in note


def test_probes_that_exchange_their_readings_at_rest_are_named_and_coarse_equal_ones_are_not():
    random, count = np.random.default_rng(0), 2000
    time, load = 1e-3 * np.arange(count), np.full(count, 5e4)
    gaps = 1e-3 + random.normal(0.0, 3e-7, (4, count)) + np.array([[0, 4e-5, 0, -2e-5]]).T
    coarse = 2e-6 * np.rint(random.normal(1e-3, 1e-6, (4, count)) / 2e-6)
    assert exchange_findings(RIG, time, load, gaps) == []
    assert exchange_findings(RIG, time, load, coarse) == []
    gaps[[1, 3], 1500:] = gaps[[3, 1], 1500:]
    (note,) = map(str, exchange_findings(RIG, time, load, gaps))
    assert note.startswith('probes 2 and 4 exchange their readings at 1.')


def test_a_ring_that_slips_across_its_clearance_exchanges_no_readings():
    x = np.r_[np.full(200, -1e-5), 8.5e-6, np.full(200, 3e-5)]
    x += np.random.default_rng(0).normal(0.0, 3e-7, x.size)
    gaps = 1e-3 + np.stack([x, 0.0 * x, -x, 0.0 * x])
    assert exchange_findings(RIG, 0.05 * np.arange(x.size), np.full(x.size, 5e3), gaps) == []


@pytest.mark.parametrize('factor', [1.0 / 60.0, 1e-3])
def test_a_load_that_rises_faster_than_the_hydraulics_is_noted(factor):
    notes = [*map(str, rig_findings(RIG, 'dynamic', factor * TIME, RAMP, SPANS))]
    (note,) = [note for note in notes if 'faster than the hydraulics' in note]
    assert 'the unit or rate of the time is wrong' in note


def test_a_record_of_milliseconds_is_refused(recording, tmp_path):
    first = min(stamps[0] for stamps in recording.stamps.values())
    for topic, stamps in recording.stamps.items():
        recording = recording.changed(topic, stamps=first + (stamps - first) // 1000)
    with pytest.raises(BagError, match='too short for a test: check the unit'):
        read_run(recording.write(tmp_path / 'bag'))
