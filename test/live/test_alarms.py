"""Claims about what the page shows of the alarm."""

from types import SimpleNamespace

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
import pytest
from rosnet import wait_until

from saddlering_interfaces.msg import ReplayState, RingAlarm
from saddlering_ros.live.session import alarm_as_page, AlarmOfTest, Session, with_link
from saddlering_ros.live.traces import CurvesOfTest
from saddlering_ros.live.watcher import REVIEW, SILENT, Watcher
from saddlering_ros.ros.messages import to_time
from saddlering_ros.ros.names import STATE

OFFLINE = 'Node offline'


def test_an_alarm_is_shown_with_channel_size_onset_guess_and_lapses():
    shown = alarm_as_page(RingAlarm(
        state=RingAlarm.ALARM, message='ALARM', channel='gamma', size=-2.5e-6,
        since=to_time(10_000_000_000), raised=to_time(10_400_000_000), follows='direction',
        first_guess='friction', materiality=[1e-6, 0.0, 2e-6],
        lapses=['9.5 s: the zero was renewed']))
    assert shown == {
        'state': 'alarm', 'words': 'ALARM', 'channel': 'gamma', 'size': '-2.50 µrad',
        'since': 10_000_000_000, 'before': 0.4, 'guess': 'friction', 'allowed': [1.0, 0.0, 2.0],
        'why': 'the difference follows the direction of the load',
        'lapses': ['the zero was renewed']}


@pytest.mark.parametrize(('state', 'shown', 'more'), [
    (RingAlarm.LEARNING, 'learning', {}),
    (RingAlarm.BLIND, 'blind', {'missing': ['/ring/residual']})])
def test_without_an_alarm_the_state_and_the_topics_that_are_missing_are_shown(state, shown, more):
    assert alarm_as_page(RingAlarm(state=state, message='words', **more)) == {
        'state': shown, 'words': 'words', 'lapses': [], 'allowed': None, **more}


def test_a_node_that_reports_no_longer_is_shown_as_offline():
    shown = alarm_as_page(RingAlarm(state=RingAlarm.WATCHING))
    silent = [{'name': '/rig1/ring_alarm: alarm', 'level': 'silent', 'words': 'Node offline'},
              {'name': 'ring_residual: zero', 'level': 'ok', 'words': ''}]
    assert with_link(shown, silent)['offline'] == 'Node offline'
    assert not with_link(shown, [{**silent[0], 'level': 'ok'}])['offline']
    assert not with_link(shown, [])['offline']
    assert with_link(None, silent) is None


@pytest.mark.ros
@pytest.mark.parametrize(('state', 'clock_leaves', 'pause', 'words', 'shown'), [
    (ReplayState.FINISHED, True, 0.0, 'Ended with its replay', 'finished'),
    (ReplayState.PLAYING, True, 0.0, 'Ended with its replay', 'stopped'),  # Ctrl-C
    (ReplayState.PLAYING, False, 0.0, OFFLINE, 'playing'),
    (ReplayState.FINISHED, True, SILENT, OFFLINE, 'finished')])
def test_a_node_that_leaves_with_its_replay_is_not_offline_but_one_that_died_in_it_is(
        ros_domain, monkeypatch, state, clock_leaves, pause, words, shown):
    """The page's clock is turned by hand: how fast the machine is does not matter."""
    page = SimpleNamespace(time=100.0)
    monkeypatch.setattr('saddlering_ros.live.watcher.time',
                        SimpleNamespace(monotonic=lambda: page.time))
    with Watcher(ros_domain) as watcher:
        if not clock_leaves:
            watcher.node.create_publisher(ReplayState, STATE, 1)
        watcher._on_alarm(RingAlarm(state=RingAlarm.BLIND))
        watcher._on_diagnostics(DiagnosticArray(status=[
            DiagnosticStatus(name='ring_alarm: alarm', message='no alarm')]))
        page.time += pause
        watcher._on_replay(ReplayState(state=state))
        page.time += REVIEW
        wait_until(lambda: watcher._has_clock != clock_leaves, what='it looks for the clock')
        page.time += SILENT
        said = watcher.state()
        assert said['alarm']['offline'] == said['health'][0]['words'] == words
        assert said['replay']['state'] == shown
        watcher._on_replay(ReplayState(state=ReplayState.PLAYING))  # another replay, without it
        assert watcher.state()['health'][0]['words'] == words


def told(state, seconds, **fields):
    """A state of the alarm at a stamp [s]."""
    message = RingAlarm(state=state, message='BLIND: nothing arrives: start it', **fields)
    message.header.stamp = to_time(round(seconds * 1e9))
    return message


def verdict(*messages, origin=10.0, newest=20.0):
    """The words on a test [s] in which these messages came."""
    seen = AlarmOfTest()
    for message in messages:
        seen.hear(message)
    return seen.verdict(round(origin * 1e9), round(newest * 1e9))['words']


def test_a_test_is_without_alarm_only_if_it_was_watched_to_its_end():
    watching, blind = told(RingAlarm.WATCHING, 12.0), told(RingAlarm.BLIND, 19.5)
    assert verdict() == 'not watched: ring_alarm did not run'
    assert verdict(watching) == verdict(watching, blind) == 'no alarm'
    assert verdict(told(RingAlarm.BLIND, 10.0)) == 'not watched: BLIND: nothing arrives'
    assert verdict(watching, told(RingAlarm.BLIND, 15.0)) == (
        'no alarm, but not watched to the end: BLIND: nothing arrives')


def test_an_alarm_counts_for_the_test_in_which_it_was_raised():
    alarm = told(RingAlarm.ALARM, 15.0, channel='gamma', size=3e-6, raised=to_time(14 * 10**9))
    assert verdict(alarm) == 'ALARM gamma +3.00 µrad'
    assert verdict(alarm, origin=30.0, newest=40.0) == 'not watched: an earlier alarm is latched'


def test_a_first_guess_that_later_samples_speak_against_is_taken_back():
    seen = AlarmOfTest()
    for seconds, follows, guess in ((15.0, '', 'too short'), (17.0, 'time', 'drift'),
                                    (19.0, 'time', 'drift'), (25.0, 'direction', 'friction')):
        seen.hear(told(RingAlarm.ALARM, seconds, raised=to_time(15 * 10**9), follows=follows,
                       first_guess=guess))
    assert seen.taken_back == [('drift', 10.0)]


def test_a_state_of_the_alarm_that_comes_late_counts_for_the_test_of_its_stamp():
    session = Session()
    earlier = CurvesOfTest(1, 10 * 10**9, 20 * 10**9, 10**7, {}, {})
    session.hear(told(RingAlarm.WATCHING, 12.0), [earlier])
    session.follow(2, '')
    session.hear(told(RingAlarm.ALARM, 20.5, channel='gamma', size=3e-6,
                      raised=to_time(14 * 10**9)), [earlier])
    assert session.as_page(earlier, {})['verdict']['level'] == 'error'
