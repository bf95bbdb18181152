"""A headless Chromium driven over its DevTools protocol: what a page says, asks for and shows."""

import asyncio
import base64
import contextlib
import json
from pathlib import Path
import shutil
import subprocess
import tempfile
import time

import aiohttp
import pytest

FLAGS = ('--headless=new', '--no-sandbox', '--disable-gpu', '--disable-quic', '--no-first-run',
         '--disable-background-networking', '--disable-component-update', '--disable-sync',
         '--disable-renderer-backgrounding', '--disable-backgrounding-occluded-windows',
         '--disable-dev-shm-usage', '--hide-scrollbars', '--window-size=1280,900',
         '--remote-debugging-port=0')
NAMES = ('chromium', 'chromium-browser', 'google-chrome', 'chrome')

# Visible texts, outside of disabled controls, whose contrast is below that of WCAG 2.1 AA.
FAINT_TEXTS = """(() => {
  const parts = (colour) => (colour.match(/[0-9.]+/g) ?? []).map(Number);
  const linear = (part) => (part <= 10.31475 ? part / 3294.6
    : ((part / 255 + 0.055) / 1.055) ** 2.4);
  const luminance = ([r, g, b]) => 0.2126 * linear(r) + 0.7152 * linear(g) + 0.0722 * linear(b);
  const behind = (element) => {
    for (let one = element; one; one = one.parentElement) {
      const [r, g, b, alpha = 1] = parts(getComputedStyle(one).backgroundColor);
      if (alpha > 0.5) return [r, g, b];
    }
    return matchMedia('(prefers-color-scheme: dark)').matches ? [18, 18, 18] : [255, 255, 255];
  };
  const walker = document.createTreeWalker(document.body, NodeFilter.SHOW_TEXT);
  const found = [];
  while (walker.nextNode()) {
    const element = walker.currentNode.parentElement;
    const text = walker.currentNode.textContent.trim();
    if (!text || element.closest('script, style, :disabled, .hoverlayer')) continue;
    if (!element.checkVisibility()) continue;
    const style = getComputedStyle(element);
    const ink = parts(element instanceof SVGElement ? style.fill : style.color);
    const pair = [luminance(ink), luminance(behind(element))].sort((a, b) => b - a);
    const size = parseFloat(style.fontSize);
    const isLarge = size >= 24 || (size >= 18.66 && style.fontWeight >= 700);
    const ratio = (pair[0] + 0.05) / (pair[1] + 0.05);
    if (ratio < (isLarge ? 3 : 4.5)) found.push(`${text.slice(0, 40)}: ${ratio.toFixed(2)}`);
  }
  return found; })()"""
CONTROLS = 'a[href], button:not(:disabled), select, summary, .modebar-btn, [tabindex="0"]'
WIDTHS = (390, 900, 1400, 2560)
"""Screens of a telephone, a tablet, a desk and a wall [px]."""



def chromium():
    """The program; skips the test where there is none."""
    found = next(filter(None, map(shutil.which, NAMES)), None)
    if found is None:
        pytest.skip('no Chromium on this machine: sudo apt install chromium')
    return found


class Page:
    """One tab. `errors`: what it wrote to the console as an error; `requests`: what it fetched."""

    def __init__(self, socket, loop):
        self._socket, self._loop = socket, loop
        self._number = 0
        self.errors, self.requests = [], []

    def send(self, method, **parameters):
        """Call one DevTools method; its result."""
        return self._loop.run_until_complete(self._send(method, parameters))

    async def _send(self, method, parameters):
        self._number += 1
        number = self._number
        await self._socket.send_json({'id': number, 'method': method, 'params': parameters})
        while True:
            message = json.loads((await self._socket.receive(60.0)).data)
            if message.get('id') == number:
                assert 'error' not in message, message['error']
                return message['result']
            self._hear(message)

    def _hear(self, message):
        method, said = message.get('method'), message.get('params', {})
        if method == 'Runtime.exceptionThrown':
            self.errors.append(said['exceptionDetails'].get('exception', {}).get(
                'description', said['exceptionDetails']['text']))
        elif method == 'Runtime.consoleAPICalled' and said['type'] in ('error', 'assert'):
            self.errors.append(' '.join(str(item.get('value', item.get('description')))
                                        for item in said['args']))
        elif method == 'Log.entryAdded' and said['entry']['level'] == 'error':
            self.errors.append(f'{said["entry"]["text"]} {said["entry"].get("url", "")}')
        elif method == 'Network.requestWillBeSent':
            self.requests.append(said['request']['url'])

    def open(self, address):
        for domain in ('Page', 'Runtime', 'Log', 'Network'):
            self.send(f'{domain}.enable')
        self.send('Page.navigate', url=address)
        self.wait('document.readyState === "complete"')

    def run(self, script):
        """The value of a JavaScript expression."""
        result = self.send('Runtime.evaluate', expression=script, returnByValue=True,
                           awaitPromise=True)
        assert 'exceptionDetails' not in result, result['exceptionDetails']
        return result['result'].get('value')

    def wait(self, script, seconds=60.0):
        """Wait until a JavaScript expression is true; returns its value."""
        deadline = time.monotonic() + seconds
        while True:
            with contextlib.suppress(AssertionError):  # a page that is being left
                value = self.run(script)
                if value:
                    return value
            assert time.monotonic() < deadline, f'never true: {script}; errors: {self.errors}'
            time.sleep(0.05)

    def text(self, selector='body'):
        return self.run(f'document.querySelector({json.dumps(selector)}).innerText')

    def faint_texts(self):
        """Texts whose contrast is too low, with their ratios."""
        return self.run(FAINT_TEXTS)

    def press(self, key, code=0, text=''):
        self.send('Input.dispatchKeyEvent', type='keyDown', key=key, windowsVirtualKeyCode=code,
                  **({'text': text} if text else {}))
        self.send('Input.dispatchKeyEvent', type='keyUp', key=key, windowsVirtualKeyCode=code)

    def beyond_the_keyboard(self):
        """Controls that the tabulator key does not reach."""
        self.run('document.activeElement.blur(), scrollTo(0, 0)')
        unreached = (f'[...document.querySelectorAll({json.dumps(CONTROLS)})].filter((it) => '
                     'it.checkVisibility() && it.dataset.reached === undefined)'
                     '.map((it) => it.outerHTML.slice(0, 80))')
        left, presses = self.run(unreached), 0
        while left and presses < 300:  # figures that come into view bring controls of their own
            self.press('Tab', 9)
            self.run('document.activeElement.dataset.reached = ""')
            left, presses = self.run(unreached), presses + 1
        return left

    def show_at(self, width, dark=False):
        """Lay the page out for a screen of this width [px], in the light or dark of the system."""
        self.send('Emulation.setDeviceMetricsOverride', width=width, height=900,
                  deviceScaleFactor=1, mobile=False)
        self.send('Emulation.setEmulatedMedia', features=[
            {'name': 'prefers-color-scheme', 'value': 'dark' if dark else 'light'}])

    def unfit_for_people(self):
        """Widths at which the page is cut, texts too faint, controls beyond the keyboard."""
        cut = []
        for width in WIDTHS:
            self.show_at(width)
            with contextlib.suppress(AssertionError):  # figures follow the width a little later
                self.wait(f'document.documentElement.scrollWidth <= {width}', 10.0)
            shown = self.run('document.documentElement.scrollWidth')
            cut += [f'{shown} px on a screen of {width} px'] if shown > width else []
        self.send('Emulation.clearDeviceMetricsOverride')
        return cut + self.faint_texts() + self.beyond_the_keyboard()

    def picture(self, path, height=900, width=1280, top=0):
        clip = {'x': 0, 'y': top, 'width': width, 'height': height, 'scale': 1}
        data = self.send('Page.captureScreenshot', clip=clip, captureBeyondViewport=True)['data']
        Path(path).write_bytes(base64.b64decode(data))

    def printed(self):
        """The page as a PDF."""
        data = self.send('Page.printToPDF', printBackground=True, preferCSSPageSize=True,
                         paperWidth=8.27, paperHeight=11.69)['data']
        return base64.b64decode(data)


@contextlib.contextmanager
def browser_page():
    """A tab of a Chromium of its own, gone afterwards."""
    program = chromium()
    loop = asyncio.new_event_loop()
    with tempfile.TemporaryDirectory(prefix='chromium_', ignore_cleanup_errors=True) as folder:
        child = subprocess.Popen(
            [program, *FLAGS, f'--user-data-dir={folder}', 'about:blank'],
            stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        try:
            page, leave = loop.run_until_complete(_connect(Path(folder), child, loop))
            try:
                yield page
            finally:
                loop.run_until_complete(leave())
        finally:
            child.terminate()
            with contextlib.suppress(subprocess.TimeoutExpired):
                child.wait(5)
            child.kill()
            child.wait()
            loop.close()


async def _connect(folder, child, loop):
    told = folder / 'DevToolsActivePort'
    deadline = time.monotonic() + 60.0
    while not (told.exists() and told.read_text().count('\n')):
        assert child.poll() is None, 'Chromium does not start'
        assert time.monotonic() < deadline, 'Chromium does not come up'
        await asyncio.sleep(0.02)
    port = told.read_text().split('\n')[0]
    session = aiohttp.ClientSession()
    async with session.get(f'http://127.0.0.1:{port}/json/list') as answer:
        tabs = [item for item in await answer.json() if item['type'] == 'page']
    socket = await session.ws_connect(tabs[0]['webSocketDebuggerUrl'], max_msg_size=0)

    async def leave():
        await socket.close()
        await session.close()
    return Page(socket, loop), leave
