"""What the live page costs: its CPU at 1 kHz, and a replay at full speed with and without it.

python benchmarks/live_page.py
"""

from __future__ import annotations

import json
import os
from pathlib import Path
import statistics
import subprocess
import sys
import time

from saddlering_ros.files import share_directory
from saddlering_ros.ros.launcher import Domain

BAG = share_directory() / 'bags' / 'dynamic_50'
COMMAND = [sys.executable, '-m', 'saddlering_ros.cli.main']
REPEATS = 3


def replay(environment: dict[str, str], rate: str) -> float:
    """Seconds that one replay takes."""
    done = subprocess.run(
        [*COMMAND, 'replay', str(BAG), '--rate', rate, '--json', '-'], env=environment,
        stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True, check=True)
    return float(json.loads(done.stdout)['seconds'])


def cpu_seconds(process: int) -> float:
    fields = Path(f'/proc/{process}/stat').read_text().rsplit(')', 1)[1].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf('SC_CLK_TCK')


def main() -> None:
    domain = Domain.take()
    environment = {**os.environ, 'ROS_DOMAIN_ID': str(domain.number),
                   'ROS_AUTOMATIC_DISCOVERY_RANGE': 'LOCALHOST'}
    alone = [replay(environment, '0') for _ in range(REPEATS)]
    page = subprocess.Popen([*COMMAND, 'live', '--port', '0', '--json', '-'], env=environment,
                            stdout=subprocess.PIPE, text=True)
    try:
        assert page.stdout is not None
        page.stdout.readline()
        time.sleep(2.0)
        beside = [replay(environment, '0') for _ in range(REPEATS)]
        before = cpu_seconds(page.pid)
        took = replay(environment, '1')
        spent = cpu_seconds(page.pid) - before
    finally:
        page.terminate()
        page.wait()
    print(f'replay of {BAG.name} at full speed, start of the nodes included: median '
          f'{statistics.median(alone):.1f} s alone, {statistics.median(beside):.1f} s beside the '
          f'page (of {REPEATS} each)')
    print(f'the page, four topics at 1 kHz in real time: {spent:.2f} s of CPU in {took:.1f} s')


if __name__ == '__main__':
    main()
