"""Bags are found at any depth and grouped into sessions of one ring."""

import csv
from pathlib import Path
import re
import shutil
from types import SimpleNamespace

from campaign_stubs import write_bag
import pytest

from saddlering_ros.bags import folder
from saddlering_ros.campaign.sessions import (
    find_bags,
    group_sessions,
    read_manifest,
    write_manifest,
)
from saddlering_ros.campaign.store import CampaignError
from saddlering_ros.campaign.task import change_since, session_verdict, tasks_of
from saddlering_ros.plain_yaml import parse_yaml
from saddlering_ros.rig import default_rig

BAGS = Path(__file__).resolve().parents[2] / 'bags'


def names(folder, **options):
    return {session.name: sorted(bag.path.name for bag in session.of_role('fit'))
            for session in group_sessions(find_bags(folder), **options)}


def test_tests_of_one_ring_within_a_day_are_one_session_and_a_longer_gap_joins_more(works):
    assert len(names(works, gap=30 * 86400.0)) == 3
    assert names(works) == {
        'SR-1 2026-01-05': ['dynamic_70', 'static_50'], 'SR-1 2026-01-12': ['static_50_again'],
        'SR-2 2026-01-05': ['dynamic_70', 'static_50'],
        'SR-3-friction 2026-01-05': ['dynamic_70', 'static_50']}


def test_an_elevation_is_held_out_where_another_is_left(works):
    sessions = group_sessions(find_bags(works), hold_out=70.0)
    assert [len(item.of_role('hold_out')) for item in sessions] == [1, 0, 1, 1]


def test_the_description_of_a_bag_is_parsed_once(tmp_path, monkeypatch):
    """Once for its files and once more for its time."""
    parsed = []
    monkeypatch.setattr(folder, 'parse_yaml', lambda text: parsed.append(text) or parse_yaml(text))
    shutil.copytree(BAGS / 'static_50', tmp_path / 'static_50')
    (bag,) = find_bags(tmp_path)
    assert len(parsed) == 1
    assert bag.time == pytest.approx(parse_yaml(parsed[0])['rosbag2_bagfile_information'][
        'starting_time']['nanoseconds_since_epoch'] / 1e9)


def test_split_bare_and_nested_bags_are_found(tmp_path):
    shutil.copytree(BAGS / 'static_50', tmp_path / 'a/b/c/static_50')
    bare = tmp_path / 'loose'
    bare.mkdir()
    shutil.copy(BAGS / 'dynamic_50_fast/dynamic_50_fast_0.mcap', bare / 'one.mcap')
    split = tmp_path / 'split'
    split.mkdir()
    for part in range(2):
        (split / f'split_{part}.mcap').write_text(f'part {part}')
    found = find_bags(tmp_path)
    assert [bag.path.relative_to(tmp_path).as_posix() for bag in found] == [
        'a/b/c/static_50', 'loose/one.mcap', 'split']
    assert found[1].fact('test') == 'dynamic'
    assert found[1].time == pytest.approx(found[0].time, abs=86400.0)


def test_a_second_copy_of_a_recording_is_skipped(works):
    shutil.copytree(works / 'SR-2', works / 'copy')
    sessions = group_sessions(find_bags(works))
    copies = [bag for item in sessions for bag in item.bags if bag.role == 'skip']
    assert len(copies) == 2
    assert 'same recording as' in copies[0].note


def test_a_damaged_bag_is_a_session_with_its_reason(works):
    (works / 'SR-2/static_50/metadata.yaml').write_text('{')
    broken = [item for item in group_sessions(find_bags(works)) if item.problem]
    assert len(broken) == 1
    assert 'metadata.yaml' in broken[0].problem
    for name in ('one.mcap', 'two.mcap'):  # each is to be given its own reason
        (works / name).write_text(name)
    assert [bag.path.name for item in group_sessions(find_bags(works)) for bag in item.bags
            if len(item.bags) == 1 and bag.path.parent == works] == ['one.mcap', 'two.mcap']


def test_a_start_that_no_clock_shows_is_unknown_and_ends_no_campaign(works):
    path = works / 'SR-2/static_50/metadata.yaml'
    path.write_text(re.sub(r'(since_epoch: )\d+', rf'\g<1>{10**25}', path.read_text()))
    sessions = group_sessions(find_bags(works))
    assert sorted(item.date for item in sessions if item.ring == 'SR-2') == ['', '2026-01-05']


def test_an_edited_manifest_overrides_the_grouping(works, tmp_path):
    bags = find_bags(works)
    write_manifest(tmp_path, group_sessions(bags))
    path = tmp_path / 'manifest.csv'
    rows = list(csv.DictReader(path.open()))
    for row in rows:
        row['session'] = 'all of SR-1' if row['ring'] == 'SR-1' else row['session']
    with path.open('w', newline='') as file:
        writer = csv.DictWriter(file, rows[0])
        writer.writeheader()
        writer.writerows(rows)
    sessions = {item.name: item for item in read_manifest(path, bags)}
    assert len(sessions['all of SR-1'].bags) == 3
    assert len(sessions) == 3
    # These corrections are a person's work: no later run drops them.
    for _ in ('by a spreadsheet', 'by a run with --manifest'):
        with pytest.raises(CampaignError, match='holds corrections: give --manifest'):
            write_manifest(tmp_path, group_sessions(bags))
        write_manifest(tmp_path, read_manifest(path, bags), path)
    path.unlink()
    write_manifest(tmp_path, group_sessions(bags))
    write_manifest(tmp_path, group_sessions(bags, gap=30 * 86400.0))


def test_columns_that_a_manifest_lacks_are_those_of_the_bags(tmp_path):
    write_bag(tmp_path, 'SR-1', 'static_50', service_hours='120', base='yes')
    bags, path = find_bags(tmp_path), tmp_path / 'm.csv'
    path.write_text(f'bag;session\n{bags[0].path};A\n')  # as a spreadsheet writes it
    (session,) = read_manifest(path, bags)
    assert (session.service_hours, session.is_base, session.maintenance) == (120.0, True, False)


def test_folders_of_one_name_are_two_rings(tmp_path):
    for ring in ('ring_7/january', 'ring_8/january'):
        write_bag(tmp_path, ring, 'static_50', rig='')
    rings = {session.ring for session in group_sessions(find_bags(tmp_path))}
    assert rings == {str(tmp_path / 'ring_7/january'), str(tmp_path / 'ring_8/january')}


@pytest.mark.parametrize('date', ['05.03.2026', '0001-01-01T00:00:00+01:00'])
def test_a_date_and_hours_that_cannot_be_read_are_noted(tmp_path, date):
    write_bag(tmp_path, 'SR-1', 'static_50', date=date, service_hours='1.200 h')
    (session,) = group_sessions(find_bags(tmp_path))
    assert (session.date, session.service_hours) == ('2026-01-05', None)
    assert f"date is '{date}', and the first stamp counts" in session.bags[0].note
    assert "service_hours is '1.200 h', and is left out" in session.bags[0].note


@pytest.mark.parametrize(('text', 'words'), [
    ('bag\nx\n', "has no column 'session'"),
    ('bag,session\nnowhere,a\n', 'line 2: nowhere is not under the folder'),
    ('bag,session,service_hours\n{0}/SR-1/static_50,a,100\n{0}/SR-1/dynamic_70,a,900\n',
     "service_hours of the session 'a' is 100 and 900: give a session one"),
    ('bag,session,note\n{0}/SR-1/static_50,a,"shaky\n{0}/SR-1/dynamic_70,a,\n',
     'm.csv: line 2: is no table.*quotation marks')])
def test_a_manifest_that_cannot_be_used_is_one_line(works, tmp_path, text, words):
    path = tmp_path / 'm.csv'
    path.write_text(text.format(works))
    with pytest.raises(CampaignError, match=words):
        read_manifest(path, find_bags(works))


def test_a_key_follows_contents_and_roles_but_not_places(works, tmp_path):
    before = {task.key for task in tasks_of(group_sessions(find_bags(works)))}
    moved = tmp_path / 'moved'
    shutil.move(works, moved)
    assert {task.key for task in tasks_of(group_sessions(find_bags(moved)))} == before
    held_out = tasks_of(group_sessions(find_bags(moved), hold_out=70.0))
    assert len({task.key for task in held_out} & before) == 1
    (moved / 'SR-1/static_50/static_50_0.mcap').write_text('other readings')
    changed = {task.key for task in tasks_of(group_sessions(find_bags(moved)))}
    assert len(changed - before) == 1


def test_later_sessions_of_a_ring_are_compared_with_its_last_base_measurement(tmp_path):
    for date, base in (('2031-01-01', 'yes'), ('2032-01-01', ''), ('2033-01-01', 'yes'),
                       ('2034-01-01', '')):
        write_bag(tmp_path / date, 'SR-9', 'static_50', date=date, base=base)
    write_bag(tmp_path / 'other', 'SR-8', 'static_50', date='2034-01-01')
    sessions = group_sessions(find_bags(tmp_path))  # by the dates stated, not by the stamps
    compared = {task.name: [bag.path for bag in task.bags if bag.role == 'base']
                for task in tasks_of(sessions)}
    assert {name: len(paths) for name, paths in compared.items()} == {
        'SR-8 2034-01-01': 0, 'SR-9 2031-01-01': 0, 'SR-9 2032-01-01': 1, 'SR-9 2033-01-01': 0,
        'SR-9 2034-01-01': 1}
    assert '2033-01-01' in compared['SR-9 2034-01-01'][0]
    write_manifest(tmp_path, sessions)
    again = read_manifest(tmp_path / 'manifest.csv', find_bags(tmp_path))
    assert [item.is_base for item in again] == [item.is_base for item in sessions]


def test_a_session_is_diagnosed_and_compared_with_its_base_measurement(tmp_path, monkeypatch):
    for date, base in (('2031-01-01', 'yes'), ('2032-01-01', '')):
        write_bag(tmp_path / date, 'SR-9', 'static_50', date=date, base=base)
    source = SimpleNamespace(covariance=None)
    monkeypatch.setattr('saddlering_ros.diagnose', lambda bags, **_: SimpleNamespace(
        verdict='none', document={'verdict': 'none'}, parameters=SimpleNamespace(source=source)))
    monkeypatch.setattr('saddlering_ros.compare', lambda before, after, *, rig, seed:
                        SimpleNamespace(to_json=lambda: {'from': before, 'to': after}))
    monkeypatch.setenv('SADDLERING_RIG', 'of_another_user.yaml')
    first, second = (session_verdict(task)
                     for task in tasks_of(group_sessions(find_bags(tmp_path))))
    assert first['change'] is None
    for place, date in (('from', '2031'), ('to', '2032')):
        path, = second['change'][place]
        assert date in path


def test_a_comparison_that_is_refused_does_not_end_the_session():
    path = str(BAGS / 'static_50')
    change = change_since([path], [path], default_rig(), 0)
    assert change['verdict'] is None
    assert 'same recording' in change['headline']
