"""Does the bag reader take a damaged bag for a sound one, crash, hang, or suspect a sound one?

    python benchmarks/fuzz.py [--seconds 60] [--cuts 1000] [--draws 3]

- cut: a bag cut at every chunk boundary and at random bytes gives its readable part, and says so;
- bytes: changed bytes for `--seconds`; an input whose answer is new is changed further;
- suspicion: virtual rigs with one hidden effect each. None may be taken for a probe wired wrongly
  (what clips may be said to stand still), and each wiring fault put in on top must be named. Of
  two probes swapped that move the same way (1 and 2, 3 and 4) it is counted how many are not.

Status 1 if anything crashed, hung, or was wrong.
"""

from __future__ import annotations

from collections.abc import Iterator
import io
import itertools
from pathlib import Path
import random
import re
import resource
import sys
import tempfile
import time
from typing import Any

from frame import arguments, ROOT
from mcap.reader import make_reader, NonSeekingReader
from mcap.writer import CompressionType, IndexType, Writer
import numpy as np
from rigs import course_bag, RIG

sys.path.append(str(ROOT / 'test' / 'bags'))

from examiner import draw_truth, DrawSettings, RecordSettings, write_campaign
from test_fuzzed_bags import edited

from saddlering_ros.bags import bag_info, read_run
from saddlering_ros.doubts.wiring import wiring_findings
from saddlering_ros.errors import BagError
from saddlering_ros.record import Record
from saddlering_ros.virtual_rig.effects import EFFECTS

SLOWEST = 10.0
"""An input that takes longer than this [s] is a fault."""

MOVE_ALIKE = ('1 and 2 swapped', '3 and 4 swapped')
SHORT_TESTS = RecordSettings(hold=1.0, static_rate=20.0, duration=3.0, dynamic_rate=500.0)
WRITERS: tuple[dict[str, Any], ...] = (
    {'compression': CompressionType.NONE, 'chunk_size': 2048},
    {'compression': CompressionType.NONE, 'use_chunking': False},
    {'compression': CompressionType.NONE, 'chunk_size': 2048, 'index_types': IndexType.NONE},
    {'compression': CompressionType.ZSTD}, {'compression': CompressionType.LZ4})
"""Kinds of bags whose bytes are changed, without checksums, so that changes reach every part."""


def rewritten(data: bytes, options: dict[str, Any]) -> bytes:
    """The messages of an MCAP file written again with other options of the writer."""
    file = io.BytesIO()
    writer = Writer(file, enable_crcs=False, **options)
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
    return file.getvalue()


def cuts(folder: Path, count: int) -> Iterator[str]:
    """One bag cut at every chunk boundary (and a byte before and behind), and at random bytes."""
    data = next(course_bag(folder, 4.0, 500.0, chunk_size=16_384).glob('*.mcap')).read_bytes()
    sound = read_run(folder / 'bag')
    summary = make_reader(io.BytesIO(data)).get_summary()
    assert summary is not None
    ends = {place + off for chunk in summary.chunk_indexes for off in (-1, 0, 1) for place in (
        chunk.chunk_start_offset, chunk.chunk_start_offset + chunk.chunk_length,
        chunk.chunk_start_offset + chunk.chunk_length + chunk.message_index_length)}
    places = sorted({*ends, *random.Random(1).sample(range(len(data)), count)})
    cut, partly, last = folder / 'cut.mcap', 0, 0
    for place in places:
        cut.write_bytes(data[:place])
        try:
            run = read_run(cut)
        except BagError as problem:
            if not re.search('cut off|MCAP|empty|does not state', str(problem)):
                yield f'cut at {place}: {problem}'
            continue
        partly += 1
        yield from judged_cut(run, sound, last, place)
        last = len(run.load)
    print(f'cut: {len(places)} places, {len(ends)} at chunk boundaries, {partly} read in part')


def judged_cut(run: Record, sound: Record, last: int, place: int) -> Iterator[str]:
    """What is wrong with the readable part of a bag cut at `place`."""
    count, kept = len(run.load), np.isfinite(run.gaps)
    if count < last:
        yield f'cut at {place}: less than from a shorter file'
    if not np.array_equal(run.load, sound.load[:count]) or not np.array_equal(
            run.gaps[kept], sound.gaps[:, :count][kept]):
        yield f'cut at {place}: other numbers'
    if not any('readable' in note for note in run.notes):
        yield f'cut at {place}: nothing said'


def outcome(path: Path) -> str:
    """What the reader makes of a file: 'read', or the line of the refusal; all else escapes."""
    answer = 'read'
    try:
        run = read_run(path, rig=RIG)
        assert np.isfinite(run.load).all()
        assert (np.diff(run.stamps) > 0).all()
    except BagError as problem:
        answer = str(problem)
        assert '\n' not in answer
    assert bag_info(path).usable or answer != 'read'
    return answer


def changed_bytes(folder: Path, seconds: float) -> Iterator[str]:
    """Changed bytes: an input whose answer is new is changed further."""
    chance = random.Random(7)
    whole = next(course_bag(folder, 0.024, 500.0).glob('*.mcap')).read_bytes()
    corpus = [rewritten(whole, options) for options in WRITERS]
    answers: set[str] = set()
    slowest, count, path = 0.0, 0, folder / 'input.mcap'
    end = time.monotonic() + seconds
    while time.monotonic() < end:
        edits = [(chance.choice(('flip', 'set', 'huge', 'delete', 'repeat', 'zero')),
                  chance.random(), chance.randrange(256)) for _ in range(chance.randint(1, 6))]
        data = edited(chance.choice(corpus), edits)
        path.write_bytes(data)
        began = time.monotonic()
        count += 1
        try:
            answer = re.sub(r'[0-9.+-]+', '#', outcome(path))
        except Exception as problem:
            kept = Path(tempfile.gettempdir()) / f'saddlering-fuzz-{count}.mcap'
            kept.write_bytes(data)
            yield f'{type(problem).__name__}: {problem} (input kept: {kept})'
            continue
        slowest = max(slowest, time.monotonic() - began)
        if answer not in answers:
            answers.add(answer)
            corpus.append(data)
    if slowest > SLOWEST:
        yield f'one input took {slowest:.1f} s'
    memory = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    print(f'bytes: {count} inputs, {len(answers)} different answers, slowest {slowest:.2f} s, '
          f'peak memory {memory:.0f} MB')


def suspicion(folder: Path, draws: int) -> Iterator[str]:
    """Hidden effects taken for wiring, and wiring faults beside them that are not named."""
    put_in = runs = alike = 0
    for (name, effect), seed in itertools.product(EFFECTS.items(), range(draws)):
        truth = draw_truth(seed, 'outside' if name.startswith('out:') else 'single',
                           DrawSettings((effect.id,), sizes=(0.6, 1.0)))
        tests = ['dynamic_50_fast'] + ['dynamic_70'] * (not effect.dynamic_only)
        for bag in write_campaign(truth, folder, tests, SHORT_TESTS, RIG, overwrite=True):
            run = read_run(bag)
            runs += 1
            notes = [*map(str, wiring_findings(RIG, run.elevation, run.load, run.gaps))]
            yield from (f'{name} {seed} {bag.name}: {note}' for note in notes
                        if 'stays at' not in note or 'saturation' not in name)
            for fault, gaps in () if notes else wired_wrongly(run):
                put_in += 1
                if wiring_findings(RIG, run.elevation, run.load, gaps):
                    continue
                if fault in MOVE_ALIKE:
                    alike += 1
                else:
                    yield f'{name} {seed} {bag.name}: {fault} is not named'
    print(f'suspicion: {runs} runs, {put_in} wiring faults put in, {alike} of them swaps alike '
          'that are not named')


def wired_wrongly(run: Record) -> Iterator[tuple[str, np.ndarray]]:
    """Each wiring fault, and the gaps (4, N) [m] of the run with it."""
    for probe in range(4):
        for fault, row in ((f'polarity of {probe + 1}', 2e-3 - run.gaps[probe]),
                           (f'{probe + 1} stuck', run.gaps[probe, np.argmax(run.load)])):
            gaps = run.gaps.copy()
            gaps[probe] = row
            yield fault, gaps
    for one, other in itertools.combinations(range(4), 2):
        gaps = run.gaps.copy()
        gaps[[one, other]] = gaps[[other, one]]
        yield f'{one + 1} and {other + 1} swapped', gaps


def main() -> int:
    args = arguments(__doc__, {'seconds': 10.0, 'cuts': 100, 'draws': 0}, seconds=60.0, cuts=1000,
                     draws=3)
    faults = 0
    for attack, size in ((cuts, args.cuts), (changed_bytes, args.seconds),
                         (suspicion, args.draws)):
        with tempfile.TemporaryDirectory() as folder:
            for fault in attack(Path(folder), size):
                faults += 1
                print(f'  FAULT {fault}', flush=True)
    return 1 if faults else 0


if __name__ == '__main__':
    sys.exit(main())
