"""Claims about what the page shows of the alarm."""

from saddlering_interfaces.msg import RingAlarm
from saddlering_ros.live.alarms import alarm_as_page, with_link
from saddlering_ros.ros.messages import to_time


def test_an_alarm_is_shown_with_channel_size_onset_guess_and_lapses():
    shown = alarm_as_page(RingAlarm(
        state=RingAlarm.ALARM, message='ALARM', channel='gamma', size=-2.5e-6,
        since=to_time(10_000_000_000), raised=to_time(10_400_000_000), follows='direction',
        first_guess='friction', lapses=['9.5 s: the zero was renewed']))
    assert shown == {
        'state': 'alarm', 'words': 'ALARM', 'channel': 'gamma', 'size': '-2.50 µrad',
        'since': 10_000_000_000, 'before': 0.4, 'follows': 'direction', 'guess': 'friction',
        'lapses': ['the zero was renewed']}


def test_without_an_alarm_the_state_is_shown_and_no_numbers():
    shown = alarm_as_page(RingAlarm(state=RingAlarm.LEARNING, message='reading the noise'))
    assert shown == {'state': 'learning', 'words': 'reading the noise', 'lapses': []}


def test_a_blind_watch_is_shown_with_the_topics_that_are_missing():
    shown = alarm_as_page(RingAlarm(state=RingAlarm.BLIND, message='BLIND: nothing arrives',
                                    missing=['/ring/residual']))
    assert shown == {'state': 'blind', 'words': 'BLIND: nothing arrives', 'lapses': [],
                     'missing': ['/ring/residual']}


def test_a_node_that_reports_no_longer_is_shown_as_offline():
    shown = alarm_as_page(RingAlarm(state=RingAlarm.WATCHING))
    silent = [{'name': '/rig1/ring_alarm: alarm', 'level': 'silent'},
              {'name': 'ring_residual: zero', 'level': 'ok'}]
    assert with_link(shown, silent)['offline']
    assert not with_link(shown, [{**silent[0], 'level': 'ok'}])['offline']
    assert not with_link(shown, [])['offline']
    assert with_link(None, silent) is None
