"""Do attacks on commands, files, campaigns and nodes end in silence, a loss or a traceback?

    python benchmarks/attacks.py [--only numbers_made_to_hurt two_users] [--bags 500]

A try is *wrong in silence* if it succeeds with other numbers than the source holds, or takes for
given what was not, without a line that a sound try does not print; *lost* if a file, a bag, a
result or an answer is gone; a *traceback* if a command ends with another status than 0 or 2, or a
refusal has more than one line. Status 1 if there is any of them.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
import contextlib
from dataclasses import replace
import io
import itertools
import math
import os
from pathlib import Path
import random
import re
import resource
import shutil
import signal
import subprocess
import sys
import tempfile
import threading
from typing import Any

from frame import arguments, ROOT, table
import numpy as np

from saddlering_ros.bags import read_raw
from saddlering_ros.record import LOAD_TOPIC
from saddlering_ros.rig import ParameterSet, TRUE_TO_SCALE, write_parameters

TESTS = ROOT / 'test'
sys.path += [str(TESTS / 'importing'), str(TESTS / 'campaign')]

Tries = Iterator[tuple[str, str, str]]
"""Of each try its name, its outcome, and what was said."""

OUTCOMES = ('done', 'said', 'refused', 'wrong in silence', 'lost', 'traceback')
ODD_NUMBERS = ('1_0', '\u0661', '\uff11', 'nan', 'inf', '-inf', '1e999', '0x10', '', '--', '1,5',
               '\u00b2')


def told(*words: object) -> tuple[str, str]:
    """How a command ended, and what it said: done, said (a note), refused or traceback."""
    from saddlering_ros.cli.main import main as command
    out, err = io.StringIO(), io.StringIO()
    try:
        with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
            status: Any = command([str(word) for word in words])
    except SystemExit as end:
        status = end.code
    except Exception as problem:
        return 'traceback', f'{type(problem).__name__}: {problem}'
    said = err.getvalue()
    if status not in (0, 2) or 'Traceback' in said or (status == 2 and said.count('\n') != 1):
        return 'traceback', f'status {status}: {said}'
    said += out.getvalue()
    return 'refused' if status == 2 else 'said' if notes_in(said) else 'done', said


def notes_in(said: str) -> set[str]:
    """The notes and warnings of a command, without their numbers."""
    return {re.sub(r'[\d.]+', '#', line) for line in said.splitlines()
            if 'note' in line or 'warning' in line}


def numbers_made_to_hurt(folder: Path) -> Tries:
    """Each numeric option of each command with texts that Python takes and people do not write."""
    from saddlering_ros.cli.main import build_parser
    parser, modules = build_parser()
    choices = parser._subparsers._group_actions[0].choices
    for name, text in itertools.product(modules, ODD_NUMBERS):
        for action in choices[name]._actions:
            if action.type not in (int, float):
                continue
            needed = [str(folder / 'none') for item in choices[name]._actions
                      if not item.option_strings and item.nargs != '?']
            outcome, said = told(name, *needed, f'{action.option_strings[-1]}={text}')
            is_number = text in ('nan', 'inf', '-inf', '1e999')  # judged by each command
            yield f'{name} {action.dest}={text!r}', (
                outcome if outcome != 'refused' or is_number or action.dest in said or any(
                    word in said for word in action.option_strings) else 'wrong in silence'), said


def logger_files(folder: Path) -> Tries:
    """TDMS and MDF files whose contents hurt: what is written must be read, or be doubted."""
    from logger_files import make_record, map_text, mdf4_bytes, write_tdms
    sound = make_record(300)
    hurts: dict[str, Callable[[np.ndarray, np.random.Generator], None]] = {
        'not a number': lambda v, rng: v.__setitem__(rng.integers(0, 300, 9), np.nan),
        'infinite': lambda v, rng: v.__setitem__(rng.integers(0, 300), np.inf),
        'beyond 32 bits': lambda v, rng: v.__setitem__(rng.integers(0, 300), 1e300),
        'all the same': lambda v, rng: v.__setitem__(slice(None), v[0]),
        'denormal': lambda v, rng: v.__setitem__(rng.integers(0, 300), 5e-324),
        'turned about': lambda v, rng: v.__setitem__(slice(None), v[::-1].copy()),
        'negative': lambda v, rng: v.__setitem__(slice(None), -v),
        'a thousand times': lambda v, rng: v.__setitem__(slice(None), 1000.0 * v)}
    clocks: dict[str, Callable[[np.ndarray, np.random.Generator], None]] = {
        'sound clock': lambda t, rng: None,
        'set back': lambda t, rng: t.__setitem__(slice(200, None), t[200:] - 3600 * 10 ** 9),
        'set back a little': lambda t, rng: t.__setitem__(slice(200, None), t[200:] - 10 ** 6),
        'set on': lambda t, rng: t.__setitem__(slice(200, None), t[200:] + 3600 * 10 ** 9),
        'stands': lambda t, rng: t.__setitem__(slice(100, 140), t[100]),
        'one row back': lambda t, rng: t.__setitem__(250, t[10])}
    usual: dict[str, set[str]] = {}
    for kind, what, when in itertools.product(('tdms', 'mf4'), ('nothing', *hurts), clocks):
        rng = np.random.default_rng([len(what), len(when)])
        record = replace(sound, stamps=sound.stamps.copy(), load=sound.load.copy(),
                         gaps=sound.gaps.copy())
        target = record.load if rng.random() < 0.5 else record.gaps[int(rng.integers(4))]
        hurts.get(what, lambda v, rng: None)(target, rng)
        clocks[when](record.stamps, rng)
        file, out = folder / f'a.{kind}', folder / 'bag'
        if kind == 'tdms':
            time_ = write_tdms(file, record)
        else:
            columns = {'t': record.stamps - record.stamps[0], **record.readings()}
            table = np.empty(300, [(name, '<i8' if name == 't' else '<f8') for name in columns])
            for name, values in columns.items():
                table[name] = values
            file.write_bytes(mdf4_bytes(int(record.stamps[0]), table, zipped=True))
            time_ = '{from: file}'
        (folder / 'map.yaml').write_text(map_text(time_))
        outcome, said = told('import', file, '--map', folder / 'map.yaml', '--out', out,
                             '--overwrite')
        if outcome != 'refused' and notes_in(said) <= usual.setdefault(kind, notes_in(said)):
            read = read_raw(out)
            is_right = all(np.array_equal(read[f'/rig/{name}'].values.astype(np.float32),
                                          values.astype(np.float32))
                           for name, values in record.readings().items())
            late = np.abs(read[LOAD_TOPIC].stamps - record.stamps).max()
            outcome = 'done' if is_right and late < 1000 else 'wrong in silence'  # npTDMS: 1 us
        yield f'{kind}: {what}, {when}', outcome, said


def full_disks(folder: Path) -> Tries:
    """Each command that writes, on a disk that is full after so many bytes, over an old file."""
    bag, law = folder / 'bag', folder / 'law.yaml'
    told('generate', bag, '--test', 'static', '--elevation', 50)
    write_parameters(law, ParameterSet(TRUE_TO_SCALE))
    outputs = {
        'generate': ('b', ['--test', 'dynamic', '--elevation', 50, '--overwrite']),
        'displacement': ('d.csv', [bag, '--out']), 'simulate': ('s.parquet', [
            bag, '--params', law, '--out']), 'residual': ('r.csv', [
                bag, '--params', law, '--out']),
        'watch': ('w.json', [bag, '--params', law, '--json']), 'info': ('i.json', [bag, '--json']),
        'validate': ('v.json', [bag, '--params', law, '--json']),
        'rig': ('x.svg', ['--drawing'])}
    for (name, (file, words)), size in itertools.product(
            outputs.items(), (0, 1, 100, 512, 2000, 5000, 20_000)):
        target = folder / file
        shutil.rmtree(target, ignore_errors=True)
        if name != 'generate':
            target.write_text('the old file')
        given = [target, *words] if name == 'generate' else [*words, target]
        whole = resource.getrlimit(resource.RLIMIT_FSIZE)
        resource.setrlimit(resource.RLIMIT_FSIZE, (size, whole[1]))
        try:
            outcome, said = told(name, *given)
        finally:
            resource.setrlimit(resource.RLIMIT_FSIZE, whole)
        if outcome == 'refused' and name != 'generate' and (
                not target.is_file() or target.read_text() != 'the old file'):
            outcome = 'lost'
        if outcome != 'refused' and target.is_file() and target.stat().st_size in (0, size):
            outcome = 'wrong in silence'
        if any(item.name.startswith('.') for item in folder.iterdir()):
            outcome = 'lost'
        yield f'{name} on {size} bytes', outcome, said


def killed_workers(folder: Path, bags: int) -> Tries:
    """Small bags of a campaign whose workers are killed."""
    from campaign_stubs import tasks, write_bag

    from saddlering_ros.campaign import run_campaign, Store
    from saddlering_ros.campaign.running import local_workers
    os.environ['PYTHONPATH'] = os.pathsep.join([str(TESTS / 'campaign'), os.getcwd()])
    for number in range(bags):
        write_bag(folder / 'bags', f'SR-{number}', 'static_50', day=float(number))
    found = tasks(folder / 'bags', 'slowly')
    store, chance, ended = Store(folder / 'store'), random.Random(3), threading.Event()
    deaths: list[int] = []

    def kill() -> None:
        while not ended.wait(chance.uniform(0.2, 1.5)):
            children = [child for thread in Path('/proc/self/task').glob('*/children')
                        for child in thread.read_text().split()]
            with contextlib.suppress(OSError, IndexError):
                os.kill(int(chance.choice(children)), signal.SIGKILL)
                deaths.append(len(deaths))

    killer = threading.Thread(target=kill)
    killer.start()
    for retry in (False, True, True):
        with local_workers(2) as workers:
            run_campaign(found, store, workers, retry=retry)
        ended.set()  # the repeated ones are left alone
    killer.join()
    print(f'{len(deaths)} workers killed')
    for task in found:
        result = store.read_result(task.key) or {}
        is_right = result.get('status') == 'done' and result['task']['ring'] == task.ring
        yield task.name, 'done' if is_right else 'lost', str(result)[:200]


def running_nodes(folder: Path) -> Tries:
    """Goals and parameters made to hurt, to nodes that run; their logs hold no traceback."""
    from rcl_interfaces.srv import SetParameters
    import rclpy
    from rclpy.action import ActionClient
    from rclpy.parameter import Parameter

    from saddlering_interfaces.action import IdentifyRing
    from saddlering_ros.ros.launcher import NodeGroup
    odd = (math.nan, math.inf, 1e-6, 50.0, 2 ** 62, '', 'x' * 10_000, [1.0, 2.0], True, '../..',
           1e300)
    names = {'ring_simulator': ('max_step', 'elevation_deg', 'parameters_file', 'rig.preload'),
             'ring_displacement': ('parity_noise', 'elevation_deg', 'lowest_rate'),
             'ring_alarm': ('materiality', 'block', 'false_alarm_hours'),
             'hydraulic_load': ('bag', 'bag_root', 'trust_rig')}
    context = rclpy.Context()
    rclpy.init(context=context, args=[], domain_id=99)
    node = rclpy.create_node('attacker', context=context)
    executor = rclpy.executors.SingleThreadedExecutor(context=context)

    def answer(future: Any) -> Any:
        executor.spin_until_future_complete(future, timeout_sec=60.0)
        return future.result()

    executor.add_node(node)
    with NodeGroup(domain_id=99, log_folder=folder) as group:
        for name in (*names, 'ring_identification'):
            group.start(name)
        for name, parameters in names.items():
            client = node.create_client(SetParameters, f'/{name}/set_parameters')
            client.wait_for_service(60.0)
            for parameter, value in itertools.product(parameters, odd):
                asked = SetParameters.Request(parameters=[
                    Parameter(parameter, value=value).to_parameter_msg()])
                given = answer(client.call_async(asked))
                is_taken = given is not None and given.results[0].successful
                yield f'{name} {parameter}={str(value)[:9]}', (
                    'lost' if given is None else 'done' if is_taken else 'refused'), str(given)
        server = ActionClient(node, IdentifyRing, 'identify_ring')
        server.wait_for_server(60.0)
        for goal in odd_goals(IdentifyRing.Goal):
            handle = answer(server.send_goal_async(goal))
            done = answer(handle.get_result_async()) if handle and handle.accepted else None
            yield f'goal {str(goal)[-60:]}', (
                'lost' if done is None else 'done' if done.status == 4 else 'refused'), ''
        for name, process in group.processes.items():
            is_whole = process.running and 'Traceback' not in process.said()
            yield name, 'done' if is_whole else 'traceback', process.said()[-500:]
    node.destroy_node()
    rclpy.try_shutdown(context=context)


def two_users(folder: Path) -> Tries:
    """Commands of another user on bags, stores and caches of this one; needs root and setpriv."""
    other = ('setpriv', '--reuid', '65534', '--regid', '65534', '--clear-groups', '--inh-caps',
             '+dac_read_search', '--ambient-caps', '+dac_read_search')  # Python may be root's own
    if os.getuid() or not shutil.which(other[0]):
        return
    folder.chmod(0o755)
    bag, kept = folder / 'bag', folder / 'kept'
    told('generate', bag, '--test', 'static', '--elevation', 50)
    told('displacement', bag)
    kept.mkdir()
    shared = folder / 'shared'
    shared.mkdir()
    shared.chmod(0o777)
    before = sorted(path.read_bytes() for path in bag.iterdir())
    for words, variables in itertools.product((
            ('info', bag), ('displacement', bag, '--out', shared / 'd.csv'),
            ('displacement', bag, '--out', folder / 'd.csv'),
            ('generate', bag, '--test', 'static', '--elevation', 50, '--overwrite'),
            ('generate', shared / 'b', '--test', 'static', '--elevation', 50, '--overwrite'),
            ('campaign', folder, '--out', kept), ('rig', '--draft', folder / 'r.yaml')),
            ({}, {'NUMBA_CACHE_DIR': str(folder)})):
        done = subprocess.run(
            [*other, sys.executable, '-m', 'saddlering_ros.cli.main', *map(str, words)],
            capture_output=True, text=True, check=False, cwd=TESTS.parent,
            env={**os.environ, 'HOME': '/nonexistent', **variables})
        outcome = {0: 'done', 2: 'refused'}.get(done.returncode, 'traceback')
        if 'Traceback' in done.stderr or (outcome == 'refused' and done.stderr.count('\n') > 1):
            outcome = 'traceback'
        if sorted(path.read_bytes() for path in bag.iterdir()) != before:
            outcome = 'lost'
        yield ' '.join(map(str, words)), outcome, done.stderr


def odd_goals(make: Any) -> list[Any]:
    """Goals of an identification that cannot be worked on."""
    return [make(**values) for values in (
        {}, {'bags': ['']}, {'bags': ['..']}, {'bags': ['/etc']}, {'bags': ['x' * 5000]},
        {'bags': ['static_50'] * 101}, {'bags': ['static_50', 'static_50']},
        {'bags': ['static_50'], 'method': 'no'},
        {'bags': ['static_50'], 'c1': math.nan},
        {'bags': ['static_50'], 'iterations': 2 ** 31 - 1},
        {'bags': ['static_50'], 'lower_bounds': [math.nan] * 6, 'upper_bounds': [1.0] * 6},
        {'bags': ['static_50'], 'lower_bounds': [1.0]},
        {'bags': ['static_50'], 'seed': 2 ** 32 - 1, 'particles': 10 ** 6})]


def main() -> int:
    args = arguments(__doc__, {'only': ['full_disks', 'two_users']},
                     only=(), bags=500)
    attacks: dict[str, Callable[[Path], Tries]] = {
        one.__name__: one for one in (numbers_made_to_hurt, logger_files, full_disks,
                                      running_nodes, two_users)}
    attacks['killed_workers'] = lambda folder: killed_workers(folder, args.bags)
    rows, faults = [], 0
    for name in args.only or attacks:
        counts = dict.fromkeys(OUTCOMES, 0)
        with tempfile.TemporaryDirectory() as folder:
            for label, outcome, said in attacks[name](Path(folder)):
                counts[outcome] += 1
                if outcome in OUTCOMES[3:]:
                    faults += 1
                    print(f'  FAULT {outcome}: {label}: {" ".join(said.split())[:300]}',
                          flush=True)
        rows.append((name, sum(counts.values()), *counts.values()))
    table('Attacks', ('attack', 'tries', *OUTCOMES), rows)
    return 1 if faults else 0


if __name__ == '__main__':
    sys.exit(main())
