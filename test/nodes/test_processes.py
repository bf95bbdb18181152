"""Starting, stopping and surviving: statuses, one-line refusals, signals, kill -9, lifecycle."""

import os
from pathlib import Path
import signal
import subprocess
import sys

from forked_nodes import endings
from lifecycle_msgs.msg import Transition
from lifecycle_msgs.srv import ChangeState, GetState
import pytest
from rcl_interfaces.msg import Parameter as ParameterMessage
from rcl_interfaces.msg import ParameterType, ParameterValue
from rcl_interfaces.srv import SetParameters
from rosnet import Client, wait_until

from saddlering_ros.files import share_directory
from saddlering_ros.ros import launcher
from saddlering_ros.ros.launcher import NodeProcess, ros_arguments, start_nodes, sweep
from saddlering_ros.ros.names import ACTION, ALARM, names, RING

pytestmark = pytest.mark.ros


REFUSED: list[tuple[str, dict[str, object], str]] = [
    ('hydraulic_load', {'bag': '/nowhere/bag'}, '/nowhere/bag'),
    ('ring_simulator', {'elevation_deg': 120.0}, 'elevation_deg is 120: give a number from -10'),
    ('ring_simulator', {'elevation_deg': 'steep'}, 'elevation_deg is'),
    ('hydraulic_load', {'bag_root': '/nowhere'}, 'give a folder that exists'),
    ('ring_displacement', {'input_reliability': 'perhaps'}, 'give one of auto, reliable'),
    ('ring_displacement', {'rig.probes.axial_span': 1.2}, 'is missing: add this section'),
    ('ring_simulator', {'parameters_file': '/nowhere/p.yaml'}, '/nowhere/p.yaml'),
    ('ring_simulator', {'contact.K1': 8.0e7}, 'contact.n1 is missing'),
    ('ring_simulator', {'contact.K1': 8.0e7, 'parameters_file': 'p.yaml'}, 'give one of them')]


def test_what_cannot_be_used_is_refused_in_one_line_with_status_2() -> None:
    cases = [(name, ros_arguments(parameters)) for name, parameters, _ in REFUSED]
    for (name, parameters, words), (status, said) in zip(REFUSED, endings(cases), strict=True):
        assert status == 2, (name, parameters, said)
        lines = [line for line in said.splitlines() if not line.startswith('[')]
        assert len(lines) == 1, lines
        assert words in lines[0]
        assert said.count(lines[0]) == 1


def children_of(pid: int) -> list[int]:
    found = subprocess.run(['ps', '--ppid', str(pid), '-o', 'pid='], capture_output=True,
                           text=True, check=False)
    return [int(number) for number in found.stdout.split()]


def alive(pid: int) -> bool:
    try:
        return Path(f'/proc/{pid}/stat').read_text().rpartition(')')[2].split()[0] != 'Z'
    except OSError:
        return False


def environment_of(node: NodeProcess) -> dict[str, str]:
    words = Path(f'/proc/{node.process.pid}/environ').read_bytes().decode().split('\0')
    return dict(word.split('=', 1) for word in words if '=' in word)


@pytest.mark.interpreters
def test_every_node_starts_as_a_program_and_ends_with_status_0_at_a_signal(
        bag: Path, ros_domain: int, tmp_path: Path) -> None:
    with start_nodes(bag, domain_id=ros_domain, log_folder=tmp_path / 'log', exit_at_end=False,
                     nodes=names(RING, ALARM, ACTION)) as group:
        assert set(group.processes) == set(names())
        wait_until(lambda: 'playing' in group.processes['replay_clock'].said(), 80.0)
        for name in names(ACTION):
            wait_until(lambda name=name: 'serves' in group.processes[name].said(), 80.0)
        for node in group.processes.values():
            assert environment_of(node)[launcher.PROFILE_VARIABLES[0]].endswith('fastdds.xml')
            assert 'XMLPARSER' not in node.said()
        for number, node in enumerate(group.processes.values()):
            os.kill(node.process.pid, (signal.SIGINT, signal.SIGTERM)[number % 2])
        wait_until(lambda: not any(node.running for node in group.processes.values()))
        assert {name: node.process.returncode for name, node in group.processes.items()} == \
            dict.fromkeys(group.processes, 0)


def test_nodes_leave_when_whoever_started_them_is_killed(bag, ros_domain, tmp_path) -> None:
    code = ('import sys, time\n'
            'from pathlib import Path\n'
            'from saddlering_ros.ros.launcher import start_nodes\n'
            f'with start_nodes({str(bag)!r}, domain_id={ros_domain}, exit_at_end=False,\n'
            f'                 log_folder=Path({str(tmp_path / "log")!r})):\n'
            '    print("started", flush=True)\n'
            '    time.sleep(600)\n')
    parent = subprocess.Popen([sys.executable, '-c', code], stdout=subprocess.PIPE, text=True)
    assert parent.stdout is not None
    assert parent.stdout.readline() == 'started\n'
    nodes = children_of(parent.pid)
    assert len(nodes) == 6
    parent.kill()
    parent.wait()
    wait_until(lambda: not any(alive(pid) for pid in nodes), what='no node is left')


def test_after_kill_9_of_all_nodes_the_next_start_replays_the_bag(bag, ros_domain, tmp_path):
    with start_nodes(bag, domain_id=ros_domain, log_folder=tmp_path / 'a', exit_at_end=False,
                     nodes=('ring_displacement',)) as group:
        wait_until(lambda: 'playing' in group.processes['replay_clock'].said(), 80.0)
        for node in group.processes.values():
            node.process.kill()
    with start_nodes(bag, domain_id=ros_domain, log_folder=tmp_path / 'b',
                     nodes=('ring_displacement',)) as group:
        assert group.wait('replay_clock', 60.0) == 0


def test_shared_memory_of_the_dead_is_swept_and_of_the_living_kept(tmp_path: Path) -> None:
    import fcntl
    for name in ('dead', 'living', 'port7400'):
        (tmp_path / f'fastrtps_{name}').touch()
        (tmp_path / f'fastrtps_{name}_el').touch()
        os.utime(tmp_path / f'fastrtps_{name}_el', (0, 0))
    with (tmp_path / 'fastrtps_living_el').open() as held:
        fcntl.flock(held, fcntl.LOCK_EX)
        assert sweep(tmp_path) == 1
    left = sorted(path.name for path in tmp_path.iterdir())
    assert left == ['fastrtps_living', 'fastrtps_living_el', 'fastrtps_port7400',
                    'fastrtps_port7400_el']


def change(heard: Client, node: str, transition: int) -> bool:
    request = ChangeState.Request(transition=Transition(id=transition))
    return bool(heard.call(ChangeState, f'/{node}/change_state', request).success)


def state(heard: Client, node: str) -> str:
    return str(heard.call(GetState, f'/{node}/get_state').current_state.label)


def test_a_node_can_be_led_through_its_lifecycle(group, heard, bag, bag_root) -> None:
    group.start('ring_displacement', {'autostart': False})
    group.start('hydraulic_load', {'bag_root': str(bag_root)})
    assert state(heard, 'ring_displacement') == 'unconfigured'
    topic = '/ring/displacement'
    for transition, expected in [(Transition.TRANSITION_CONFIGURE, 'inactive'),
                                 (Transition.TRANSITION_ACTIVATE, 'active'),
                                 (Transition.TRANSITION_DEACTIVATE, 'inactive'),
                                 (Transition.TRANSITION_ACTIVATE, 'active')]:
        assert change(heard, 'ring_displacement', transition)
        assert state(heard, 'ring_displacement') == expected
        wait_until(lambda on=expected == 'active': heard.matched((topic,)) == on, what=expected)

    # rclpy's own callback raises here, which ended the node.
    assert not change(heard, 'ring_displacement', Transition.TRANSITION_CONFIGURE)
    assert state(heard, 'ring_displacement') == 'active'

    # A replay node without a bag waits; it cannot be configured until it has one.
    assert not change(heard, 'hydraulic_load', Transition.TRANSITION_CONFIGURE)
    assert state(heard, 'hydraulic_load') == 'unconfigured'
    shipped = share_directory() / 'bags' / 'static_50'
    for path, words in [(shipped, 'is not below'), ('../elsewhere', 'is not below'),
                        (bag, ''), (bag.name, '')]:
        value = ParameterValue(type=ParameterType.PARAMETER_STRING, string_value=str(path))
        request = SetParameters.Request(parameters=[ParameterMessage(name='bag', value=value)])
        result = heard.call(SetParameters, '/hydraulic_load/set_parameters', request).results[0]
        assert result.successful == (not words)
        assert words in result.reason
    assert change(heard, 'hydraulic_load', Transition.TRANSITION_CONFIGURE)
    assert change(heard, 'hydraulic_load', Transition.TRANSITION_ACTIVATE)

    # Settings out of range or fixed are refused with the reason.
    for name, number, words in [('parity_noise', 5.0, 'parity_noise'),
                                ('max_gap', 3.0, 'read-only')]:
        value = ParameterValue(type=ParameterType.PARAMETER_DOUBLE, double_value=number)
        request = SetParameters.Request(parameters=[ParameterMessage(name=name, value=value)])
        result = heard.call(SetParameters, '/ring_displacement/set_parameters', request).results[0]
        assert not result.successful
        assert words in result.reason
