"""Commands that write on full and on slow disks."""

from __future__ import annotations

import os
from pathlib import Path
import random
import resource
import subprocess
import sys
import tempfile
import time

from .stage import Outcome
from .truth import cycle_bag, Truth


def slow_disk_library(folder: Path) -> Path:
    """A library that makes every write and fsync of a process take 0.2 s."""
    source = folder / 'slow.c'
    source.write_text(
        '#define _GNU_SOURCE\n#include <dlfcn.h>\n#include <unistd.h>\n#include <sys/stat.h>\n'
        'static int is_file(int fd) {\n'
        '  struct stat s;\n  return !fstat(fd, &s) && S_ISREG(s.st_mode);\n}\n'
        'ssize_t write(int fd, const void *data, size_t size) {\n'
        '  static ssize_t (*real)(int, const void *, size_t);\n'
        '  if (!real) real = dlsym(RTLD_NEXT, "write");\n'
        '  if (is_file(fd)) usleep(200000);\n  return real(fd, data, size);\n}\n'
        'int fsync(int fd) {\n  static int (*real)(int);\n'
        '  if (!real) real = dlsym(RTLD_NEXT, "fsync");\n'
        '  usleep(200000);\n  return real(fd);\n}\n')
    library = folder / 'slow.so'
    subprocess.run(['cc', '-shared', '-fPIC', '-o', str(library), str(source), '-ldl'], check=True)
    return library


def full_disk(chance: random.Random) -> Outcome:
    """Commands that write where there is no room: status 2, one line, the old file kept."""
    out = Outcome()
    truth = Truth.make()
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        bag, _ = cycle_bag(folder, truth, 3)
        place, mounted = folder / 'full', False
        place.mkdir()
        if os.geteuid() == 0:
            done = subprocess.run(['mount', '-t', 'tmpfs', '-o', 'size=64k', 'tmpfs', str(place)],
                                  capture_output=True, check=False)
            mounted = done.returncode == 0
        try:
            for output in ('d.csv', 'd.parquet'):
                out.put_in += 1
                target = place / output
                target.write_text('old')
                done = subprocess.run(
                    [sys.executable, '-m', 'saddlering_ros.cli.main', 'displacement', str(bag),
                     '--out', str(target)], capture_output=True, text=True, check=False,
                    preexec_fn=None if mounted else limit_files)
                lines = done.stderr.splitlines()
                if done.returncode != 2 or len(lines) != 1 or 'cannot be written' not in lines[0]:
                    out.faults.append(f'{output}: status {done.returncode}, {done.stderr[-200:]}')
                if target.read_text() != 'old' or len(list(place.iterdir())) != 1:
                    out.faults.append(f'{output}: the old file is not alone there any more')
                target.unlink()
        finally:
            if mounted:
                subprocess.run(['umount', str(place)], check=False)
        out.faults += killed_on_a_slow_disk(folder, bag, chance)
        out.put_in += 3
    out.figures['on a full tmpfs'] = float(mounted)
    return out


def killed_on_a_slow_disk(folder: Path, bag: Path, chance: random.Random) -> list[str]:
    """A command killed while it writes on a slow disk leaves the old file or the new one."""
    library = slow_disk_library(folder)
    target = folder / 'samples.csv'
    faults = []
    command = [sys.executable, '-m', 'saddlering_ros.cli.main', 'displacement', str(bag), '--out',
               str(target)]
    subprocess.run(command, check=True, capture_output=True)
    new = target.read_bytes()
    for _ in range(3):
        target.write_text('old')
        process = subprocess.Popen(command, env={**os.environ, 'LD_PRELOAD': str(library)},
                                   stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        while not list(folder.glob('.samples*')) and process.poll() is None:
            time.sleep(0.01)
        time.sleep(chance.uniform(0.0, 1.0))
        process.kill()
        process.wait()
        if target.read_bytes() not in (b'old', new):
            faults.append('half a file was left behind')
    return faults


def limit_files() -> None:
    """Files of this process may have 64 kB."""
    resource.setrlimit(resource.RLIMIT_FSIZE, (65536, 65536))
