"""The bag reader under attack: cut everywhere, changed bytes by coverage, faults it must suspect.

python benchmarks/fuzz.py [--seconds 60] [--cuts 1000] [--draws 3] [--quick] [--json FILE]

- cut: a bag cut at every chunk boundary and at random bytes gives its readable part, and says so;
- bytes: changed bytes for `--seconds`, guided by what the reader answers (an input whose answer is
  new is changed further);
- suspicion: virtual rigs with one hidden effect each; none may be taken for a probe wired wrongly
  (what clips may be said to stand still), and each wiring fault put in on top must be named; of
  two probes swapped that move the same way (1 and 2, 3 and 4) it is counted how many are.

Status 1 if anything crashed, hung, took too much memory, or was wrong.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
import io
import itertools
import json
from pathlib import Path
import random
import re
import resource
import sys
import tempfile
import time
from typing import Any

from mcap.reader import make_reader, NonSeekingReader
from mcap.writer import CompressionType, IndexType, Writer
import numpy as np

from saddlering_ros.bags import bag_info, read_run, write_bag
from saddlering_ros.doubts.finding import lines
from saddlering_ros.doubts.wiring import wiring_findings
from saddlering_ros.errors import BagError
from saddlering_ros.record import Record, TestMetadata
from saddlering_ros.rig import default_rig, TONNE

RIG = default_rig()
SLOWEST = 10.0
"""An input that takes longer than this [s] is a fault."""

MOVE_ALIKE = ('1 and 2 swapped', '3 and 4 swapped')

_NUMBERS = re.compile(r'[0-9.+-]+')


def small_bag(folder: Path, samples: int, chunk_size: int = 1 << 20) -> Path:
    """A dynamic test of `samples` at 500 Hz, whose only file is the path given back."""
    chance = np.random.default_rng(0)
    stamps = 1_700_000_000_000_000_000 + 2_000_000 * np.arange(samples)
    load = TONNE * (0.5 + 24.5 * np.sin(np.linspace(0.0, np.pi, samples)) ** 2)
    motion = np.array([[3.8], [7.0], [-3.8], [-9.2]]) * 1e-6 * load / TONNE
    gaps = 1e-3 + np.asarray(RIG.probes.polarity)[:, None] * motion \
        + chance.normal(0.0, 3e-7, motion.shape)
    bag = write_bag(folder, TestMetadata('dynamic', 50.0, 'a rig', 'a run'), stamps, load,
                    [stamps + 100_000 * probe for probe in range(4)], list(gaps), RIG.probes,
                    chunk_size=chunk_size)
    return next(bag.glob('*.mcap'))


def rewritten(data: bytes, path: Path, **options: Any) -> Path:
    """The messages of an MCAP file written again with other options of the writer."""
    with path.open('wb') as file:
        writer = Writer(file, **options)
        writer.start('ros2')
        channels: dict[int, int] = {}
        for schema, channel, message in NonSeekingReader(io.BytesIO(data)).iter_messages():
            if channel.id not in channels:
                number = writer.register_schema(schema.name, schema.encoding, schema.data)
                channels[channel.id] = writer.register_channel(
                    channel.topic, channel.message_encoding, number)
            writer.add_message(channels[channel.id], message.log_time, message.data,
                               message.publish_time)
        writer.add_metadata('saddlering.test', {'test': 'dynamic', 'elevation_deg': '50'})
        writer.finish()
    return path


def seeds(folder: Path) -> list[Path]:
    """Small bags of every kind, without checksums, so that changes reach the innermost parts."""
    folder.mkdir()
    data = small_bag(folder / 'bag', 12).read_bytes()
    plain = {'enable_crcs': False, 'compression': CompressionType.NONE}
    kinds = {
        'indexed': {**plain, 'chunk_size': 2048}, 'loose': {**plain, 'use_chunking': False},
        'walked': {**plain, 'chunk_size': 2048, 'index_types': IndexType.NONE},
        'zstd': {**plain, 'compression': CompressionType.ZSTD},
        'lz4': {**plain, 'compression': CompressionType.LZ4}}
    found = [rewritten(data, folder / f'{name}.mcap', **options)
             for name, options in kinds.items()]
    for file in (folder / 'bag').iterdir():
        file.unlink()
    (folder / 'bag').rmdir()
    return found


def outcome(path: Path) -> str:
    """What the reader makes of a file: 'read', or the line of the refusal; all else escapes."""
    try:
        run = read_run(path, rig=RIG)
        answer = 'read'
        assert np.isfinite(run.load).all()
        assert (np.diff(run.stamps) > 0).all()
    except BagError as problem:
        answer = str(problem)
        assert '\n' not in answer
    info = bag_info(path)
    assert info.usable or answer != 'read' or run.test == 'static'
    return answer


# --- cut ---

def cuts(count: int) -> dict[str, Any]:
    """One bag cut at every chunk boundary (and a byte before and behind), and at random bytes."""
    faults: list[str] = []
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        data = small_bag(folder / 'bag', 2000, 16_384).read_bytes()
        sound = read_run(folder / 'bag')
        chunks = make_reader(io.BytesIO(data)).get_summary().chunk_indexes
        ends = [place + off for chunk in chunks for off in (-1, 0, 1) for place in (
            chunk.chunk_start_offset, chunk.chunk_start_offset + chunk.chunk_length,
            chunk.chunk_start_offset + chunk.chunk_length + chunk.message_index_length)]
        places = sorted({*ends, *random.Random(1).sample(range(len(data)), count)})
        cut = folder / 'cut.mcap'
        partly, last = 0, 0
        for place in places:
            cut.write_bytes(data[:place])
            try:
                run = read_run(cut)
            except BagError as problem:
                if 'cut off' not in str(problem) and 'MCAP' not in str(problem) and \
                        'empty' not in str(problem) and 'does not state' not in str(problem):
                    faults.append(f'cut at {place}: {problem}')
                continue
            partly += 1
            faults += judged_cut(run, sound, last, place)
            last = len(run.load)
    return {'cuts': len(places), 'at chunk boundaries': len(set(ends)), 'read in part': partly,
            'faults': faults}


def judged_cut(run: Record, sound: Record, last: int, place: int) -> list[str]:
    """What is wrong with the readable part of a bag cut at `place`."""
    count = len(run.load)
    kept = np.isfinite(run.gaps)
    if count < last:
        return [f'cut at {place}: less than from a shorter file']
    if not np.array_equal(run.load, sound.load[:count]) or \
            not np.array_equal(run.gaps[kept], sound.gaps[:, :count][kept]):
        return [f'cut at {place}: other numbers']
    if not any('readable' in note for note in run.notes):
        return [f'cut at {place}: nothing said']
    return []


# --- bytes ---

def changed(data: bytes, chance: random.Random) -> bytes:
    """`data` with one to six changes."""
    result = bytearray(data)
    for _ in range(chance.randint(1, 6)):
        place, width = chance.randrange(len(result)), chance.choice((1, 2, 4, 8, 31))
        kind = chance.randrange(6)
        if kind == 0:
            result[place] ^= 1 << chance.randrange(8)
        elif kind == 1:
            result[place:place + width] = chance.randbytes(width)
        elif kind == 2:
            number = chance.choice((0, 1, 0xff, 0xffff, 2 ** 31 - 1, 2 ** 32 - 1, 2 ** 63 - 1))
            result[place:place + 8] = number.to_bytes(8, 'little')
        elif kind == 3:
            del result[place:place + width]
        elif kind == 4:
            result[place:place] = result[place:place + 10 * width]
        else:
            other = chance.randrange(len(result))
            result[place:place + width] = result[other:other + width]
        result = result or bytearray(b'\0')
    return bytes(result)


def by_answers(folder: Path, seconds: float) -> dict[str, Any]:
    """Changed bytes: an input whose answer is new is changed further."""
    chance = random.Random(7)
    corpus = [path.read_bytes() for path in seeds(folder / 'seeds')]
    answers: set[str] = set()
    faults: list[str] = []
    slowest, count, path = 0.0, 0, folder / 'input.mcap'
    end = time.monotonic() + seconds
    while time.monotonic() < end:
        data = changed(chance.choice(corpus), chance)
        path.write_bytes(data)
        began = time.monotonic()
        try:
            answer = _NUMBERS.sub('#', outcome(path))
        except Exception as problem:
            kept = Path(tempfile.gettempdir()) / f'saddlering-fuzz-{count}.mcap'
            kept.write_bytes(data)
            faults.append(f'{type(problem).__name__}: {problem} (input kept: {kept})')
            continue
        slowest = max(slowest, time.monotonic() - began)
        count += 1
        if answer not in answers:
            answers.add(answer)
            corpus.append(data)
    if slowest > SLOWEST:
        faults.append(f'one input took {slowest:.1f} s')
    return {'inputs': count, 'different answers': len(answers),
            'slowest [s]': slowest, 'peak memory [MB]': resource.getrusage(
                resource.RUSAGE_SELF).ru_maxrss / 1024, 'faults': faults}


# --- suspicion ---

def suspicion(draws: int) -> dict[str, Any]:
    """Hidden effects taken for wiring, and wiring faults beside them that are not named."""
    from saddlering_ros.virtual_rig.campaign import (
        draw_truth,
        DrawSettings,
        RecordSettings,
        SINGLE,
        write_campaign,
    )
    from saddlering_ros.virtual_rig.effects import EFFECTS
    record = RecordSettings(hold=1.0, static_rate=20.0, duration=3.0, dynamic_rate=500.0)
    false, missed, runs, put_in, alike = [], [], 0, 0, 0
    for (name, effect), seed in itertools.product(EFFECTS.items(), range(draws)):
        truth = draw_truth(seed, 'outside' if name.startswith('out:') else SINGLE,
                           DrawSettings((effect.id,), sizes=(0.6, 1.0)))
        with tempfile.TemporaryDirectory() as folder:
            names = ['dynamic_50_fast'] if effect.dynamic_only else [
                'dynamic_50_fast', 'dynamic_70']
            for bag in write_campaign(truth, Path(folder), names, record, RIG):
                run = read_run(bag)
                runs += 1
                notes = lines(wiring_findings(RIG, run.elevation, run.load, run.gaps))
                false += [f'{name} {seed} {bag.name}: {note}' for note in notes
                          if 'stays at' not in note or 'saturation' not in name]
                found, of = put_in_faults(run, bool(notes))
                put_in += of
                alike += sum(fault in MOVE_ALIKE for fault in found)
                missed += [f'{name} {seed} {bag.name}: {fault}' for fault in found
                           if fault not in MOVE_ALIKE]
    return {'runs': runs, 'wrongly suspected': len(false), 'wiring faults put in': put_in,
            'not named': len(missed), 'not named of swaps alike': alike,
            'faults': [*false, *missed]}


def put_in_faults(run: Record, already: bool) -> tuple[list[str], int]:
    """Wiring faults of `run` that nothing is said of, and how many were tried."""
    if already:
        return [], 0
    faults: dict[str, Callable[[np.ndarray], np.ndarray]] = {}
    for probe in range(4):
        faults[f'polarity of {probe + 1}'] = lambda gaps, probe=probe: with_row(
            gaps, probe, 2e-3 - gaps[probe])
        faults[f'{probe + 1} stuck'] = lambda gaps, probe=probe: with_row(
            gaps, probe, np.full(gaps.shape[1], gaps[probe, np.argmax(run.load)]))
    for one, other in itertools.combinations(range(4), 2):
        order = list(range(4))
        order[one], order[other] = other, one
        faults[f'{one + 1} and {other + 1} swapped'] = lambda gaps, order=order: gaps[order]
    return [what for what, change in faults.items()
            if not wiring_findings(RIG, run.elevation, run.load, change(run.gaps))], len(faults)


def with_row(gaps: np.ndarray, probe: int, row: np.ndarray) -> np.ndarray:
    result = gaps.copy()
    result[probe] = row
    return result


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument('--seconds', type=float, default=60.0)
    parser.add_argument('--cuts', type=int, default=1000)
    parser.add_argument('--draws', type=int, default=3, help='virtual rigs per effect')
    parser.add_argument('--quick', action='store_true')
    parser.add_argument('--json', type=Path)
    args = parser.parse_args()
    if args.quick:
        args.seconds, args.cuts, args.draws = 10.0, 100, 0
    figures = {}
    with tempfile.TemporaryDirectory() as name:
        for title, measure in [('cut', lambda: cuts(args.cuts)),
                               ('bytes', lambda: by_answers(Path(name), args.seconds)),
                               ('suspicion', lambda: suspicion(args.draws))]:
            figures[title] = measure()
            print(f'\n{title}')
            for what, value in figures[title].items():
                shown = f'{value:.2f}' if isinstance(value, float) else value
                if what != 'faults':
                    print(f'  {what:24} {shown}', flush=True)
            for fault in figures[title]['faults']:
                print(f'  FAULT {fault}', flush=True)
    if args.json:
        args.json.write_text(json.dumps(figures, indent=2) + '\n')
    return 1 if any(part['faults'] for part in figures.values()) else 0


if __name__ == '__main__':
    sys.exit(main())
