"""Bags without readings and judging functions that take no time, for tests around them."""

from dataclasses import replace
import json
import os
from pathlib import Path
import signal
import time
from typing import Any

import yaml

from saddlering_ros.campaign.sessions import find_bags, group_sessions
from saddlering_ros.campaign.task import SessionTask, tasks_of
from saddlering_ros.doubts.comparison import refuse_parameters_of_other_rig
from saddlering_ros.errors import SaddleringError
from saddlering_ros.rig import default_rig, ParameterSet, TRUE_TO_SCALE

START = 1_767_600_000

NAMES = ('K1', 'n1', 'D1', 'K2', 'n2', 'D2')
VALUES = (1.3e8, 1.11, 3e6, 1.3e8, 1.11, 3e6)


def verdict_document(verdict: str = 'none') -> dict[str, Any]:
    """What a diagnosis answers, as small as the tables need it."""
    after = dict(zip(NAMES, VALUES, strict=True))
    after |= {f'{name}_std': 0.01 * value for name, value in after.items()}
    causes = [] if verdict == 'none' else [{
        'effect': 'radial_friction', 'group': ['radial_friction'],
        'parameters': {'force': {'value': 5e3, 'std': 100.0, 'unit': 'N'}},
        'evidence': {'p_value': 1e-9, 'delta_bic': 50.0},
        'gain': {'fit': 0.8, 'held_out': 0.7}}]
    return {
        'verdict': verdict, 'causes': causes, 'parameters': {'before': {}, 'after': after},
        'next_test': None, 'gain': {'fit': 0.0, 'held_out': 0.0},
        'detection_limits': [{'effect': 'radial_friction', 'limit': 300.0,
                              'material_limit': 200.0, 'unit': 'N', 'testable': True}]}


def judge(task: SessionTask) -> dict[str, Any]:
    """A verdict by the ring's name; each call leaves a mark beside the bags."""
    mark(task)
    return answer(task)


def answer(task: SessionTask) -> dict[str, Any]:
    """What `judge` answers."""
    if 'refused' in task.ring:
        raise SaddleringError(f'{task.name}: the load never rises: repeat the test')
    if 'broken' in task.ring:
        raise ZeroDivisionError('no such thing')
    verdict = 'named' if 'friction' in task.ring else 'none'
    covariance = [[(0.01 * VALUES[row]) ** 2 if row == column else 0.0 for column in range(6)]
                  for row in range(6)]
    return {'verdict': verdict_document(verdict), 'covariance': covariance, 'report': ''}


def on_another_rig(task: SessionTask) -> dict[str, Any]:
    """Refuses its rig, as a diagnosis does."""
    law = ParameterSet(TRUE_TO_SCALE)
    refuse_parameters_of_other_rig(
        replace(law, source=replace(law.source, rig_hash='0' * 64)), default_rig())
    return {}


def slowly(task: SessionTask) -> dict[str, Any]:
    """The same after a while, and never for an endless ring."""
    mark(task)
    time.sleep(3600.0 if task.ring == 'endless' else 0.4)
    return answer(task)


def forever(task: SessionTask) -> dict[str, Any]:
    """Never answers."""
    mark(task)
    time.sleep(3600.0)
    return {}


def greedy(task: SessionTask) -> dict[str, Any]:
    """Takes memory until it gets no more."""
    parts = []
    while True:
        parts.append(bytearray(1 << 24))


def killed(task: SessionTask) -> dict[str, Any]:
    """Dies as by the kernel's out-of-memory killer."""
    mark(task)
    os.kill(os.getpid(), signal.SIGKILL)
    return {}


def mark(task: SessionTask) -> None:
    """One line more in a file beside the bags: how often a session was judged."""
    folder = Path(task.bags[0].path).parent.parent / 'marks'
    folder.mkdir(exist_ok=True)
    with (folder / task.key).open('a') as file:
        file.write(json.dumps({'process': os.getpid()}) + '\n')


def marks(folder: Path) -> dict[str, list[int]]:
    """Processes that judged each session under `folder`, by key."""
    return {
        path.name: [json.loads(line)['process'] for line in path.read_text().splitlines()]
        for path in (folder / 'marks').glob('*')}


def write_bag(folder: Path, ring: str, name: str, *, day: float = 0.0, elevation: float = 50.0,
              **facts: str) -> Path:
    """A rosbag2 directory whose recording is one line of text."""
    bag = folder / ring / name
    bag.mkdir(parents=True)
    (bag / f'{name}_0.mcap').write_text(f'{ring} {name} {day} {facts}')
    custom = {'test': name.partition('_')[0], 'elevation_deg': f'{elevation:g}', 'rig': ring,
              **facts}
    information = {
        'relative_file_paths': [f'{name}_0.mcap'], 'storage_identifier': 'mcap',
        'custom_data': custom,
        'starting_time': {'nanoseconds_since_epoch': int((START + 86400 * day) * 1e9)}}
    (bag / 'metadata.yaml').write_text(
        yaml.safe_dump({'rosbag2_bagfile_information': information}))
    return bag


def tasks(folder: Path, compute: str = 'judge', **limits: float) -> list[SessionTask]:
    """Tasks of the bags under `folder`, judged by a function of this file."""
    sessions = group_sessions(find_bags(folder))
    return tasks_of(sessions, None, **limits, compute=f'campaign_stubs:{compute}')
