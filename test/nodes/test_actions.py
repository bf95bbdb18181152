"""Both action servers: refusal with a reason, one goal at a time, feedback, cancel, result."""

import contextlib
import json
import os
from pathlib import Path
import signal
from types import SimpleNamespace
from typing import Any

from action_msgs.msg import GoalStatus
from action_msgs.srv import CancelGoal
import pytest
from rosnet import Client, Driver, wait_until

from saddlering_interfaces.action import DiagnoseRing, IdentifyRing
from saddlering_interfaces.msg import RingParameters
from saddlering_ros.api import functions
from saddlering_ros.bags.write import write_bag
from saddlering_ros.jobs import requests
from saddlering_ros.record.batches import Displacements, Samples
from saddlering_ros.record.displacement import DisplacementStream
from saddlering_ros.record.record import TestMetadata
from saddlering_ros.rig import default_rig, PARAMETER_NAMES
from saddlering_ros.ros.launcher import NodeGroup, NodeProcess
from saddlering_ros.ros.messages import fill_diagnosis
from saddlering_ros.ros.names import NodeError
from saddlering_ros.ros.parameters import below

pytestmark = pytest.mark.ros


def offline_displacement(record: Any, rows: slice) -> Displacements:
    return DisplacementStream(default_rig()).push(
        Samples(record.stamps[rows], record.load[rows]),
        [Samples(stamps[rows], gaps[rows]) for stamps, gaps in
         zip(record.probe_stamps, record.gaps, strict=True)])


class Goals:
    """Sends goals and waits for what comes of them.

    Feedback is read from its topic: a client of rclpy drops what it has not yet taken when the
    result comes.
    """

    def __init__(self, heard: Client, action: Any, name: str) -> None:
        self.heard, self.action = heard, action
        self.client = heard.action(action, name)
        self._feedback: dict[bytes, list[Any]] = {}
        with heard.lock:
            topic = heard.node.create_subscription(
                action.Impl.FeedbackMessage, f'{name}/_action/feedback',
                lambda message: self.feedback_of(message).append(message.feedback), 1000)
        wait_until(lambda: bool(self.client.server_is_ready()
                                and topic.get_publisher_count()), 80.0, name)
        wait_until(self._is_matched, 80.0, 'a first goal ends')

    def feedback_of(self, goal: Any) -> list[Any]:
        """Feedback of a goal so far; goal: its handle, or a message of it."""
        return self._feedback.setdefault(bytes(goal.goal_id.uuid), [])

    def _is_matched(self) -> bool:
        """Whether a goal that cannot be used ends: both ends of all replies then know each other.

        A server drops an answer if it has not found the client's reader within 0.1 s.
        """
        with contextlib.suppress(AssertionError):
            handle = self.send(seconds=5.0)
            return handle.accepted and bool(self.result(handle, 5.0))
        return False

    def _wait(self, future: Any, seconds: float = 60.0) -> Any:
        wait_until(future.done, seconds, 'an answer')
        return future.result()

    def send(self, seconds: float = 60.0, **goal: Any) -> Any:
        with self.heard.lock:
            future = self.client.send_goal_async(self.action.Goal(**goal))
        return self._wait(future, seconds)

    def result(self, handle: Any, seconds: float = 60.0) -> Any:
        with self.heard.lock:
            future = handle.get_result_async()
        return self._wait(future, seconds)

    def cancel(self, handle: Any) -> None:
        with self.heard.lock:
            future = handle.cancel_goal_async()
        assert self._wait(future).goals_canceling


def stop_worker(node: NodeProcess) -> None:
    """Hold the worker process of an action server where it is; a kill still ends it."""
    worker, = [int(number) for task in Path(f'/proc/{node.process.pid}/task').iterdir()
               for number in (task / 'children').read_text().split()]
    os.kill(worker, signal.SIGSTOP)


def test_identification_refuses_cancels_and_publishes_what_it_found(
        bag: Path, bag_root: Path, group: NodeGroup, heard: Client, tmp_path: Path) -> None:
    node = group.start('ring_identification', {'bag_root': str(bag_root)})
    found = heard.listen(RingParameters, '/ring/parameters')
    goals = Goals(heard, IdentifyRing, '/identify_ring')

    # Fifty goals at once that cannot be used: every one is answered.
    with heard.lock:
        sent = [goals.client.send_goal_async(IdentifyRing.Goal()) for _ in range(50)]
    wait_until(lambda: all(future.done() for future in sent), what='all fifty are answered')

    # What cannot be used is aborted at once, with the reason.
    for goal, words in [
            ({'bags': []}, 'names no bags'),
            ({'bags': ['/etc/passwd']}, 'is not below'),
            ({'bags': ['../elsewhere']}, 'is not below'),
            ({'bags': ['none']}, 'check the name'),
            ({'bags': ['run'], 'method': 'guess'}, "'guess'"),
            ({'bags': ['run'], 'lower_bounds': [1.0], 'upper_bounds': [2.0]}, 'give six each'),
            ({'bags': ['run'], 'lower_bounds': [9e9] * 6, 'upper_bounds': [1.0] * 6}, 'bounds'),
            ({'bags': ['run'], 'method': 'paper'}, 'static')]:
        answer = goals.result(goals.send(**goal))
        assert answer.status == GoalStatus.STATUS_ABORTED
        assert answer.result.status == IdentifyRing.Result.REFUSED
        assert words in answer.result.message
        assert '\n' not in answer.result.message

    # A goal that runs is canceled; one that comes meanwhile is rejected.
    long = goals.send(bags=['run'], particles=10_000, iterations=100_000, seed=1)
    wait_until(lambda: bool(goals.feedback_of(long)), 60.0, 'feedback')
    stop_worker(node)  # or it might be done before the cancel
    assert goals.feedback_of(long)[0].stage
    assert not goals.send(bags=['run']).accepted
    # By its service, as anyone can if the client is gone.
    assert heard.call(CancelGoal, '/identify_ring/_action/cancel_goal').goals_canceling
    answer = goals.result(long)  # benchmarks/ros_speed.py measures how soon
    assert answer.status == GoalStatus.STATUS_CANCELED
    assert answer.result.status == IdentifyRing.Result.CANCELED
    assert not found

    # Cancels that come too late, fifty at once, are answered too.
    with heard.lock:
        late = [long.cancel_goal_async() for _ in range(50)]
    wait_until(lambda: all(future.done() for future in late), 120.0, 'every cancel is answered')

    # And the next one succeeds.
    short = goals.send(bags=['run'], particles=8, iterations=5, seed=1)
    answer, feedback = goals.result(short), goals.feedback_of(short)
    assert answer.status == GoalStatus.STATUS_SUCCEEDED, answer.result.message
    result = answer.result
    assert result.status == IdentifyRing.Result.SUCCEEDED
    assert json.loads(result.report_json)['parameters']['K1']['value'] == result.parameters.k1
    assert {'channels', 'bag'} <= json.loads(result.validation_json)[0].keys()
    wait_until(lambda: bool(feedback) and feedback[-1].stage.startswith('validate'),
               what='the last feedback')
    assert len(feedback) > 2
    assert 0.0 <= feedback[0].progress <= feedback[-1].progress <= 1.0
    assert list(result.undetermined) == [name for name, is_determined in zip(
        PARAMETER_NAMES, result.parameters.determined, strict=True) if not is_determined]
    assert result.offered
    wait_until(lambda: bool(found), what='/ring/parameters')
    assert found[-1] == result.parameters


def test_a_goal_that_takes_longer_than_allowed_is_ended(bag_root, bag, group, heard) -> None:
    group.start('ring_identification', {'bag_root': str(bag_root), 'longest_goal': 1.0})
    goals = Goals(heard, IdentifyRing, '/identify_ring')
    answer = goals.result(goals.send(bags=['run'], particles=1000, iterations=5000, seed=1))
    assert answer.status == GoalStatus.STATUS_ABORTED
    assert answer.result.status == IdentifyRing.Result.FAILED
    assert 'longest_goal, 1 s' in answer.result.message


def test_other_nodes_lose_nothing_and_the_server_answers_while_one_identifies(
        record, bag: Path, bag_root: Path, group: NodeGroup, heard: Client) -> None:
    for name in ('ring_displacement', 'ring_simulator', 'ring_residual'):
        group.start(name)
    group.extra_environment = {'SADDLERING_THREADS': '1'}  # it lasts, and costs no more
    group.start('ring_identification', {'bag_root': str(bag_root)})
    driver, goals = Driver(heard), Goals(heard, IdentifyRing, '/identify_ring')
    wait_until(lambda: driver.matched(2) and heard.ring_nodes_matched(), 80.0, 'all are matched')
    # The swarm stops after some 40 iterations without progress: its size makes it last.
    long = goals.send(bags=['run'], particles=10_000, iterations=100_000, seed=1)
    wait_until(lambda: bool(goals.feedback_of(long)), 60.0, 'it runs')
    heard.diagnostics.clear()
    name = 'ring_identification: /identify_ring'
    wait_until(lambda: heard.diagnostics.get(name, (0, 'idle'))[1] not in ('idle', 'starting'),
               what='the server reports that it identifies')
    rows = slice(0, 400)
    driver.send(record, rows, pace=200)
    owed = len(offline_displacement(record, rows))
    wait_until(lambda: len(heard.raw['/ring/residual']) == owed, 60.0, f'{owed} residuals')
    goals.cancel(long)
    assert goals.result(long).status == GoalStatus.STATUS_CANCELED


def test_a_diagnosis_that_succeeds_gives_its_causes_typed_and_as_json(
        record: Any, bag_root: Path, group: NodeGroup, heard: Client) -> None:
    gain, at_rest = 0.05, slice(0, 300)
    gaps = [gap.copy() for gap in record.gaps]
    gaps[0] += gain * (gaps[0] - gaps[0][at_rest].mean())
    write_bag(bag_root / 'gain', TestMetadata('dynamic', 50.0), record.stamps, record.load,
              record.probe_stamps, gaps, default_rig().probes)
    group.start('ring_diagnosis', {'bag_root': str(bag_root)})
    goals = Goals(heard, DiagnoseRing, '/diagnose_ring')
    handle = goals.send(bags=['gain'], seed=1)
    answer, feedback = goals.result(handle, 200.0), goals.feedback_of(handle)
    assert answer.status == GoalStatus.STATUS_SUCCEEDED, answer.result.message
    result = answer.result
    document = json.loads(result.verdict_json)
    assert (result.verdict, result.next_test) == (document['verdict'], document['next_test'])
    assert result.next_test
    assert [cause.effect for cause in result.causes] == [
        cause['effect'] for cause in document['causes']]
    (cause,), (written,) = result.causes, document['causes']
    assert 'probe_gain' in cause.group
    assert list(cause.group) == written['group']
    found = dict(zip(cause.parameter_names, zip(cause.values, cause.stds, cause.lower, cause.upper,
                                                strict=True), strict=True))
    assert found.keys() == written['parameters'].keys()
    for name, (value, std, low, high) in found.items():
        size = written['parameters'][name]
        assert (value, std) == (size['value'], size['std'])
        assert [low, high] == (size['interval'] or [value, value])  # a chosen one has none
    assert found['gain'][2] < gain < found['gain'][3]
    assert cause.misfit_reduction_fit == written['gain']['fit'] > 0.5
    wait_until(lambda: bool(feedback) and feedback[-1].progress > feedback[0].progress,
               what='feedback of its progress')


def test_a_goal_with_an_earlier_session_compares(bag, bag_root, group, heard) -> None:
    group.start('ring_diagnosis', {'bag_root': str(bag_root)})
    goals = Goals(heard, DiagnoseRing, '/diagnose_ring')
    for goal, words in [({'hold_out': ['run']}, 'takes neither hold_out nor parameters_file'),
                        ({'parameters_file': 'p.yaml'}, 'neither hold_out nor parameters_file'),
                        ({}, 'same recording')]:
        answer = goals.result(goals.send(before=['run'], bags=['run'], **goal))
        assert answer.result.status == DiagnoseRing.Result.REFUSED
        assert words in answer.result.message
        assert '\n' not in answer.result.message


def test_a_change_fills_the_result_of_the_action(monkeypatch: Any) -> None:
    document = {'verdict': 'none', 'headline': 'Nothing changed.', 'causes': [],
                'detection_limits': [{
                    'effect': 'load_gain', 'limit': 0.01, 'best_limit': 0.01, 'unit': '1',
                    'material_limit': 0.02, 'testable': True, 'one_session': 0.05}]}
    change = SimpleNamespace(verdict='none', headline='Nothing changed.',
                             to_json=lambda: document)
    monkeypatch.setattr(functions, 'compare', lambda before, after, **options: change)
    answer = requests.run(requests.DiagnosisRequest(
        ('later',), ('earlier',), (), default_rig(), '', 0), lambda progress: None)
    assert answer.parameters is None
    result = DiagnoseRing.Result()
    fill_diagnosis(result, json.loads(answer.fields['verdict_json']))
    assert result.verdict == result.NONE
    assert result.detection_limits[0].limit == 0.01


def test_a_goal_that_runs_when_the_server_is_told_to_stop_still_ends(bag, bag_root, group, heard):
    node = group.start('ring_diagnosis', {'bag_root': str(bag_root)})
    goals = Goals(heard, DiagnoseRing, '/diagnose_ring')
    handle = goals.send(bags=['run'])
    assert handle.accepted
    with heard.lock:
        future = handle.get_result_async()
    wait_until(lambda: bool(goals.feedback_of(handle)), what='it runs')
    stop_worker(node)  # or it might be done before the node is told
    node.process.terminate()
    wait_until(future.done, what='the goal ends')
    assert future.result().result.status == DiagnoseRing.Result.FAILED
    assert 'shutting down' in future.result().result.message
    assert node.process.wait(60.0) == 0


def test_bags_are_found_below_the_root_only(tmp_path: Path) -> None:
    root, outside = tmp_path / 'root', tmp_path / 'outside'
    (root / 'a').mkdir(parents=True)
    outside.mkdir()
    (root / 'link').symlink_to(outside)
    (root / 'inner').symlink_to(root / 'a')
    real = root.resolve()
    assert below(real, 'a', 'bag') == real / 'a'
    assert below(real, str(root / 'a'), 'bag') == real / 'a'
    assert below(real, 'inner', 'bag') == real / 'a'
    for name in ('link', '../outside', str(outside), '', 'a/../../outside', '\0',
                 'a' * 100_000):
        with pytest.raises(NodeError):
            below(real, name, 'bag')
