"""The live page in a browser, over real nodes that replay a bag."""

import contextlib
import json
import threading
import time
import urllib.request

from browser import browser_page, chromium
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
import numpy as np
import pytest
import rclpy
from rclpy.action import ActionServer, CancelResponse
from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.executors import MultiThreadedExecutor
from rosnet import client, wait_until
from served_page import served_page
from std_srvs.srv import Trigger

from saddlering_interfaces.action import DiagnoseRing, IdentifyRing
from saddlering_interfaces.msg import RingAlarm
from saddlering_ros.bags.reader import read_raw, read_run
from saddlering_ros.live.watcher import Watcher
from saddlering_ros.record.displacement import displacement_of_run
from saddlering_ros.rig import default_rig
from saddlering_ros.ros.launcher import RING_NODES, start_nodes, transport_environment
from saddlering_ros.ros.raw_topics import LATCHED

pytestmark = [pytest.mark.ros, pytest.mark.timeout(600)]
LISTENERS = 2
"""Who reads what a node gives out: the test and the page, and ring_residual where it runs."""
VERDICT = {'verdict': 'named', 'next_test': 'Load twice as fast.', 'gain': {'fit': 0.9},
           'causes': [{'effect': 'radial_friction', 'group': ['radial_friction'],
                       'parameters': {'force': {'value': 9e3, 'std': 35.0, 'unit': 'N'}}}]}


@pytest.fixture(autouse=True)
def _transport(monkeypatch):
    for name, value in transport_environment().items():
        monkeypatch.setenv(name, value)


@contextlib.contextmanager
def replayed(domain, bag, nodes=RING_NODES):
    """A replay of a bag at full speed, begun when its nodes know that the page listens.

    The bag has fewer messages on a topic than the queues hold: the page loses none.
    """
    def is_heard(node):
        said = heard.progress.get(node)
        more = 'ring_residual' in nodes and node != 'ring_residual'
        return said is not None and said.subscriptions[0] >= LISTENERS + more

    with client(domain) as heard, start_nodes(
            bag, domain_id=domain, start_paused=True, nodes=nodes) as group:
        wait_until(lambda: all(is_heard(node) for node in nodes) and (
            nodes != RING_NODES or heard.ring_nodes_matched()), 80.0, 'the page is matched')
        assert heard.call(Trigger, '/replay_clock/play').success
        yield group


@contextlib.contextmanager
def served(domain, port=0):
    """The page of a domain; its address."""
    with Watcher(domain) as watcher, served_page(watcher, port) as where:
        yield where


class Servers:
    """Both action servers: an identification that goes on until canceled, a verdict at once."""

    def __init__(self, domain):
        self.context = rclpy.Context()
        rclpy.init(context=self.context, domain_id=domain)
        self.node = rclpy.create_node('actions', context=self.context)
        group = ReentrantCallbackGroup()
        options = {'callback_group': group, 'cancel_callback': lambda _: CancelResponse.ACCEPT}
        self._servers = [
            ActionServer(self.node, IdentifyRing, '/identify_ring', self._identify, **options),
            ActionServer(self.node, DiagnoseRing, '/diagnose_ring', self._diagnose, **options)]
        self.clients = {
            kind: rclpy.action.ActionClient(self.node, kind, path) for kind, path in (
                (IdentifyRing, '/identify_ring'), (DiagnoseRing, '/diagnose_ring'))}
        self._executor = MultiThreadedExecutor(4, context=self.context)
        self._executor.add_node(self.node)
        threading.Thread(target=self._executor.spin, daemon=True).start()

    def close(self):
        """Leave the domain: what stays would be taken for a server by the tests that follow."""
        self._executor.shutdown(timeout_sec=5.0)
        for one in (*self._servers, *self.clients.values()):
            one.destroy()
        self.node.destroy_node()
        rclpy.shutdown(context=self.context)

    def _identify(self, goal):
        turn = 0
        while not goal.is_cancel_requested and self.context.ok():
            turn = min(turn + 1, 50)
            goal.publish_feedback(IdentifyRing.Feedback(
                stage='swarm', iteration=turn // 2, iterations=50, best_objective=1.25,
                elapsed=10.0, progress=0.3))
            time.sleep(0.05)
        goal.canceled()
        return IdentifyRing.Result(status=IdentifyRing.Result.CANCELED, message='canceled')

    def _diagnose(self, goal):
        goal.publish_feedback(DiagnoseRing.Feedback(stage='screening', progress=0.5, elapsed=1.0))
        time.sleep(0.5)
        goal.succeed()
        return DiagnoseRing.Result(verdict='named', verdict_json=json.dumps(VERDICT))

    def say_well(self, page):
        """Report on /diagnostics until the page shows it, then never again."""
        said = self.node.create_publisher(DiagnosticArray, '/diagnostics', 10)
        status = DiagnosticStatus(name='a_node: task', message='up')

        def is_shown():
            said.publish(DiagnosticArray(status=[status]))
            return page.run('document.querySelector("#nodes [data-level=ok]") !== null')

        wait_until(is_shown, what='the page shows a node that is well')

    def alarm(self, **fields):
        """Publish a state of the alarm, as ring_alarm does."""
        said = self.node.create_publisher(RingAlarm, '/ring/alarm', LATCHED)
        while not said.get_subscription_count():
            time.sleep(0.01)
        said.publish(RingAlarm(**fields))

    def ask(self, kind):
        client = self.clients[kind]
        assert client.wait_for_server(60.0)
        client.send_goal_async(kind.Goal(bags=['any']))


TITLES_THAT_OVERLAP = """(() => {
  const boxes = [...document.querySelectorAll('#plots .annotation, #plots .modebar-group')].map(
    (it) => it.getBoundingClientRect());
  return boxes.filter((one, i) => boxes.some((other, j) => i < j && one.left < other.right
    && other.left < one.right && one.top < other.bottom && other.top < one.bottom));
})()"""


def check_cursor_zoom_and_way_back(page):
    """The keyboard moves one cursor through all plots, zooms in time, and returns to now."""
    page.run('figure.focus()')
    page.press('ArrowLeft', 37)
    page.press('ArrowLeft', 37)
    assert page.wait('document.querySelectorAll("#plots .shapelayer path").length === 13')
    said = page.text('#readout')
    assert all(word in said for word in ('UTC', 'load', 'simulated', 'residual')), said
    page.press('+', text='+')
    shown = page.wait('span && figure.layout.xaxis7.range')
    assert page.run('figure.layout.xaxis4.range') == shown
    page.wait('!document.querySelector("#back").hidden')
    page.run('document.querySelector("#back").click()')
    page.wait('document.querySelector("#back").hidden && figure.layout.xaxis4.autorange')
    page.wait('document.querySelectorAll("#plots .shapelayer path").length === 6')


def differences(whole, saved):
    """Topics whose samples in the saved bag are not those of the whole one, and in what."""
    found = []
    for topic in whole:
        one, other = whole[topic], saved[topic]
        lost = np.flatnonzero(~np.isin(one.stamps, other.stamps))
        if lost.size or one.stamps.shape != other.stamps.shape:
            found.append(f'{topic}: {other.stamps.size} of {one.stamps.size} samples; lost are '
                         f'{lost.size} from row {lost[:1]} to {lost[-1:]}')
        elif not np.array_equal(one.values, other.values):
            found.append(f'{topic}: values of rows {np.flatnonzero(one.values != other.values)}')
    return found


def check_picture_and_bag(page, where, bag, folder):
    """What is seen is saved: the picture by the browser, the bag with the messages replayed."""
    page.send('Browser.setDownloadBehavior', behavior='allow', downloadPath=str(folder))
    page.run('document.querySelector("#picture").click()')
    wait_until(lambda: list(folder.glob('Curves_of_*.png')), 30.0, 'the picture is saved')
    saved = folder / 'saved.mcap'
    saved.write_bytes(urllib.request.urlopen(
        where.url + page.run('document.querySelector("#bag").getAttribute("href")')).read())
    other = read_raw(saved)
    assert differences(read_raw(bag), other) == [], page.text('#lost')
    assert other.facts.elevation_deg == pytest.approx(50.0)


def check_list_of_tests(page):
    """Each test of the session is listed with its verdict, and can be looked at again."""
    assert page.wait('document.querySelectorAll("#tests button").length === 2')
    assert 'not watched: ring_alarm did not run' in page.text('#tests')
    page.run('document.querySelectorAll("#tests button")[1].click()')
    page.wait('earlier !== null && earlier.residual.size > 20 && streams.residual.size === 0')
    page.wait('!document.querySelector("#back").hidden')
    page.press('Escape', 27)
    page.run('figure.focus()')
    page.press('Escape', 27)
    page.wait('earlier === null && document.querySelector("#back").hidden')


def test_a_replay_is_drawn_as_it_happens_and_outlives_reloads_and_restarts(
        campaign, ros_domain, tmp_path):
    chromium()
    bag, = campaign('radial_friction', 8000.0, 'force', ('dynamic_50_fast',))
    run = read_run(bag)
    peak = 1e6 * float(np.nanmax(displacement_of_run(default_rig(), run).displacement.delta_x))
    highest = 'Math.max(...[...streams.measured.values()].map((it) => it.high[0]))'
    with served(ros_domain) as where, browser_page() as page:
        page.open(where.url)
        page.wait('document.querySelector("#link").innerText === "Connected"')
        with replayed(ros_domain, bag) as group:
            page.wait('+document.body.dataset.points > 20', 60.0)
            page.wait('document.querySelectorAll(".gauge .span").length === 4')
            page.wait('/Load[^]*[0-9.]+ t[^]*kN/.test(document.querySelector("#now").innerText)')
            page.wait('document.querySelectorAll("#plots .scatterlayer .trace").length === 13')
            group.wait('replay_clock', 60.0)
            assert page.wait(f'Math.abs({highest} - {peak}) < 1e-3')
        page.run('document.querySelector("details:has(#parameters) summary").click()')
        for words in ('true to scale', 'N/mm^n', 'probe 4', 'ring_residual', 'Replay finished',
                      'Test dynamic_50_fast', 'as simulated', 'test ended'):
            page.wait(f'document.body.innerText.includes({json.dumps(words)})')
        assert page.wait('document.querySelectorAll("#plots .shapelayer path").length === 6')
        assert 'None received' not in page.text('#now')
        assert page.text('#lost') == ''
        for width, columns, dark in ((1400, 3, False), (900, 3, True), (390, 1, False),
                                     (2560, 3, True)):
            page.show_at(width, dark)
            # Plots stand one below the other where they do not fit beside each other.
            page.wait('document.querySelector("#plots .main-svg").clientWidth '
                      '=== figure.clientWidth && new Set(["xaxis", "xaxis2", "xaxis3"].map('
                      f'(it) => figure.layout[it].domain[0])).size === {columns}')
            assert page.run('document.documentElement.scrollWidth') == width
            assert page.run(TITLES_THAT_OVERLAP) == []
            page.wait(f'getComputedStyle(document.body).colorScheme && {str(dark).lower()} === '
                      '(figure.layout.font.color !== "#1f2933")')
            assert page.faint_texts() == []
        page.show_at(1400)
        assert page.beyond_the_keyboard() == []
        check_cursor_zoom_and_way_back(page)
        check_picture_and_bag(page, where, bag, tmp_path)
        page.send('Page.reload')
        page.wait('document.readyState === "complete" && +document.body.dataset.points > 20')
        assert page.wait(f'Math.abs({highest} - {peak}) < 1e-3')
        page.run('post("clear")')
        page.wait('streams.measured.size === 0')
        with replayed(ros_domain, bag, ('ring_displacement',)) as group:
            group.wait('replay_clock', 60.0)
            # How many points stand for it depends on when they came; its highest does not.
            assert page.wait(f'streams.measured.size > 20 && Math.abs({highest} - {peak}) < 1e-3')
        check_list_of_tests(page)
        assert page.errors == []
        assert [url for url in page.requests
                if not url.startswith((where.url, 'data:', 'blob:'))] == []


def test_alarm_and_progress_are_shown_canceled_by_a_click_and_a_verdict_comes(ros_domain):
    chromium()
    with contextlib.closing(Servers(ros_domain)) as servers, browser_page() as page:
        with served(ros_domain) as where:
            page.open(where.url)
            servers.say_well(page)
            servers.alarm(state=RingAlarm.BLIND, message='BLIND: nothing arrives',
                          missing=['/ring/residual'])
            page.wait('document.querySelector("#alarm.blind")?.innerText.includes('
                      '"Missing: /ring/residual")')
            servers.alarm(state=RingAlarm.ALARM, channel='delta_x', size=3.25e-6,
                          first_guess='a probe that slipped', lapses=['1 s: zero renewed'])
            page.wait('document.querySelector("#alarm.alarm")?.innerText.includes("+3.25 µm")')
            assert 'a probe that slipped' in page.text('#alarm')
            assert 'zero renewed' in page.text('#alarm')
            servers.alarm(state=RingAlarm.ALARM, channel='delta_x', follows='time',
                          first_guess='drift')
            page.wait('document.querySelector("#alarm").innerText.includes("drift")')
            servers.alarm(state=RingAlarm.ALARM, channel='delta_x', follows='load',
                          first_guess='stiffness')
            page.wait('document.querySelector("#alarm s")?.innerText === "drift"')
            assert 'Reason: the difference follows the load' in page.text('#alarm')
            assert page.faint_texts() == []
            servers.ask(IdentifyRing)
            page.wait('document.querySelector(".job[data-action=identify][data-state=running]")'
                      '?.innerText.includes("best 1.25")')
            page.wait('/about \\d+ s left/.test(document.querySelector(".job").innerText)')
            page.run('document.querySelector(".job button").click()')
            page.wait('document.querySelector(".job[data-state=canceled]") !== null')
            servers.ask(DiagnoseRing)
            page.wait('!document.querySelector("#verdict").hidden')
            said = page.text('#verdict')
            assert 'The simulation lacks dry friction in the radial row' in said
            assert 'Load twice as fast.' in said
            page.wait('document.querySelector("#nodes [data-level=silent]") !== null')
            assert page.errors == []
        page.wait('document.querySelector("#link").innerText.includes("trying again")')
        with served(ros_domain, where.port):
            page.wait('document.querySelector("#link").innerText === "Connected"', 20.0)
