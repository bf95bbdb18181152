"""Claims about who may look at the live page, and who may not."""

import asyncio
import json
import re
import signal
import socket
import subprocess
import sys
from types import SimpleNamespace
import urllib.request

from aiohttp import CookieJar
from aiohttp.test_utils import TestClient, TestServer
from colour_vision import APART, smallest_difference
import pytest
from rosnet import ended

from saddlering_ros.cli.main import main
from saddlering_ros.errors import LiveError
from saddlering_ros.live.server import Address, application, PAGE, serve
from saddlering_ros.rig import default_rig

POST = {'X-Saddlering': 'live'}


def asked(where, *requests, watcher=None):
    """Statuses of requests (method, path, headers) by one client, one after another."""
    async def ask():
        server = TestServer(application(watcher or SimpleNamespace(rig=default_rig()), where))
        async with TestClient(server, cookie_jar=CookieJar(unsafe=True)) as client:
            found = []
            for method, path, headers in requests:
                async with client.request(method, path, headers=headers) as answer:
                    found.append(answer.status)
            return found
    return asyncio.run(ask())


HERE, BEYOND = Address('127.0.0.1', 0), Address('0.0.0.0', 0)
ANOTHER = Address('127.0.0.2', 0)
SESAME = Address('0.0.0.0', 0, 'open sesame')


@pytest.mark.parametrize(('where', 'requests', 'statuses'), [
    (HERE, [('GET', '/', {}), ('GET', '/live.js', {}), ('GET', '/rig.svg', {})], [200, 200, 200]),
    (ANOTHER, [('GET', '/', {'Host': host}) for host in ('127.0.0.2:80', 'evil.example')],
     [200, 403]),
    *((HERE, [('GET', '/', {'Host': host})], [403]) for host in (
        'evil.example', '127.0.0.1:80@evil.com', 'localhost:1:2', '127.0.0.1.evil.com',
        '[::1].evil')),
    *((BEYOND, [('GET', path, {}), ('POST', '/clear', POST)], [403, 403])
      for path in ('/', '/events', '/plotly.js', '/?token=wrong')),
    (SESAME, [('GET', '/?token=open%20sesame', {}), ('GET', '/live.css', {})], [200, 200])])
def test_who_may_look_is_let_in_and_nobody_else(where, requests, statuses):
    assert asked(where, *requests) == statuses


def test_beyond_this_machine_a_token_is_made_and_needed():
    assert HERE.token == ''
    assert len(BEYOND.token) >= 20
    assert BEYOND.token in BEYOND.url


def test_the_page_shows_the_drawing_of_the_ring():
    assert 'src="rig.svg"' in (PAGE / 'page.html').read_text(encoding='utf-8')


def luminance(colour):
    """Relative luminance of '#rgb' or '#rrggbb' (WCAG 2.1)."""
    digits = colour[1:] if len(colour) == 7 else ''.join(2 * digit for digit in colour[1:])
    parts = [int(digits[place:place + 2], 16) / 255 for place in (0, 2, 4)]
    linear = [part / 12.92 if part <= 0.04045 else ((part + 0.055) / 1.055)**2.4 for part in parts]
    return 0.2126 * linear[0] + 0.7152 * linear[1] + 0.0722 * linear[2]


@pytest.mark.parametrize('theme', [0, 1], ids=['light', 'dark'])
def test_text_of_the_page_meets_the_contrast_of_wcag_aa_in_both_themes(theme):
    root = re.findall(r':root {(.*?)}', (PAGE / 'live.css').read_text(), re.DOTALL)[theme]
    colours = dict(re.findall(r'--(\w+): (#\w+);', root))
    for text in ('ink', 'soft', 'good', 'warning', 'bad'):
        for ground in ('card', 'back', 'hover'):
            dark, bright = sorted(map(luminance, (colours[text], colours[ground])))
            assert (bright + 0.05) / (dark + 0.05) >= 4.5, (text, ground)


@pytest.mark.parametrize('theme', [0, 1], ids=['light', 'dark'])
def test_the_colour_blind_tell_the_curves_and_bands_apart(theme):
    root = re.findall(r':root {(.*?)}', (PAGE / 'live.css').read_text(), re.DOTALL)[theme]
    colours = dict(re.findall(r'--(\w+): (#\w+);', root))
    card = '#ffffff' if colours['card'] == '#fff' else colours['card']
    broad, band = (  # they are drawn half transparent
        '#' + bytes(sum(pair) // 2 for pair in zip(
            bytes.fromhex(colours[name][1:]), bytes.fromhex(card[1:]), strict=True)).hex()
        for name in ('measured', 'noise'))
    allowed, simulated = colours['allowed'], colours['simulated']
    for pair in ((broad, simulated), (band, simulated), (allowed, simulated), (band, allowed)):
        assert smallest_difference(*pair) >= APART, pair


def test_another_site_cannot_cancel_but_the_page_can_and_its_commands_reach_the_nodes():
    heard = []
    identification = SimpleNamespace(cancel=lambda: heard.append('identify'))
    watcher = SimpleNamespace(actions={'identify': identification},
                              commands=SimpleNamespace(ask=heard.append))
    requests = [('POST', '/cancel/identify', {}), ('POST', '/cancel/identify', POST),
                ('POST', '/cancel/else', POST), ('POST', '/zero', {}),
                *(('POST', f'/{name}', POST) for name in ('zero', 'start', 'pause'))]
    assert asked(HERE, *requests, watcher=watcher) == [403, 200, 404, 403, 200, 200, 200]
    assert heard == ['identify', 'zero', 'start', 'pause']


def test_a_port_that_is_taken_is_refused_in_one_line():
    with socket.create_server(('127.0.0.1', 0)) as taken:
        port = taken.getsockname()[1]
        with pytest.raises(LiveError, match=f'127.0.0.1:{port}: cannot be served'):
            serve(SimpleNamespace(), Address('127.0.0.1', port), lambda where: None)


@pytest.mark.ros
def test_the_command_says_where_its_page_is_and_ends_by_a_signal(ros_domain, tmp_path):
    said = tmp_path / 'said.json'
    command = [sys.executable, '-m', 'saddlering_ros.cli.main', 'live', '--port', '0', '--json',
               str(said)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as live, ended(live):
        line = live.stdout.readline()
        told = json.loads(said.read_text())
        assert line.startswith(f'{told["url"]} shows ROS domain {ros_domain};')
        with urllib.request.urlopen(told['url'], timeout=60.0) as page:
            assert b'<html' in page.read()
        live.send_signal(signal.SIGINT)
        assert live.wait(60.0) in (0, 130)


@pytest.mark.parametrize(('options', 'words'), [
    (('--port', '70000'), 'give 0 to 65535'), (('--window', '0'), 'give 1 to 86400 seconds')])
def test_what_the_command_cannot_use_is_refused_in_one_line(options, words, capsys):
    assert main(['live', *options]) == 2
    line = capsys.readouterr().err
    assert words in line
    assert line.count('\n') == 1
