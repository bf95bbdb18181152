"""The examiner: draws a rig with hidden faults, writes its bags, seals the truth, prints the seal.

Run it as a process of its own: `python -m saddlering_ros.virtual_rig.blind --seed N --out DIR`. It
writes DIR/<run>/ (bags) and DIR/truth.sealed, and prints one line of JSON with the bags and the
SHA-256 of the sealed file. `open_seal` gives the truth to who can show that digest. The score of a
verdict after the seal is opened stands here too: benchmark and test suite share this rule.
"""

from __future__ import annotations

import argparse
import base64
from collections.abc import Sequence
from dataclasses import dataclass
import hashlib
import json
from pathlib import Path
import sys
from typing import Any
import zlib

from scipy.stats import binom

from saddlering_ros.errors import SaddleringError, VirtualRigError
from saddlering_ros.files import write_text
from saddlering_ros.virtual_rig import campaign
from saddlering_ros.virtual_rig.campaign import DrawSettings, OUTSIDE, RecordSettings, Truth
from saddlering_ros.virtual_rig.effects import find_effect

SEALED = 'truth.sealed'


def seal(path: Path, truth: Truth) -> str:
    """Write the truth so that no one reads it by accident; return the digest of the file."""
    text = json.dumps(truth.to_json(), sort_keys=True)
    sealed = base64.b85encode(zlib.compress(text.encode(), 9)).decode()
    write_text(path, sealed + '\n')
    return digest_of(path)


def digest_of(path: Path) -> str:
    """SHA-256 of a sealed file."""
    return hashlib.sha256(path.read_bytes()).hexdigest()


def open_seal(path: Path, digest: str) -> dict[str, Any]:
    """The truth of a sealed file; VirtualRigError if it is not the one that was sealed."""
    if not path.is_file():
        raise VirtualRigError(f'{path}: there is no sealed truth: give the folder of a blind test')
    if digest_of(path) != digest:
        raise VirtualRigError(f'{path}: the seal is broken: this is not the file that was sealed')
    truth: dict[str, Any] = json.loads(zlib.decompress(base64.b85decode(path.read_text().strip())))
    return truth


def main(argv: Sequence[str] | None = None) -> int:
    """Draw, write, seal, print."""
    args = _parser().parse_args(argv)
    try:
        truth = campaign.draw_truth(args.seed, args.kind, _settings(args))
        record = RecordSettings(args.hold, args.static_rate, args.duration, args.dynamic_rate)
        runs = args.runs.split(',') if args.runs else tuple(campaign.RUNS)
        bags = campaign.write_campaign(truth, args.out, runs, record)
        digest = seal(args.out / SEALED, truth)
    except SaddleringError as problem:
        print(f'blind: {problem}', file=sys.stderr)
        return 2
    print(json.dumps({'seed': args.seed, 'bags': [str(bag) for bag in bags], 'seal': digest}))
    return 0


def _settings(args: argparse.Namespace) -> DrawSettings:
    effects = tuple(find_effect(name).id for name in args.effect)
    low, high = args.sizes
    if not -2.0 <= low <= high <= 2.0:
        raise VirtualRigError(f'--sizes are {low:g} {high:g}: give two numbers '
                              'from 0 to 1, low first')
    return DrawSettings(effects, (low, high))


def _parser() -> argparse.ArgumentParser:
    record = RecordSettings()
    parser = argparse.ArgumentParser(
        prog='python -m saddlering_ros.virtual_rig.blind', description=__doc__)
    parser.add_argument('--seed', type=int, required=True)
    parser.add_argument('--out', type=Path, required=True, metavar='DIR')
    parser.add_argument('--kind', choices=campaign.KINDS, default=campaign.SINGLE)
    parser.add_argument('--effect', action='append', default=[], metavar='NAME',
                        help='draw from these only (may be repeated)')
    parser.add_argument('--sizes', type=float, nargs=2, default=(0.3, 1.0),
                        metavar=('LOW', 'HIGH'), help='part of the plausible sizes, 0 to 1')
    parser.add_argument('--runs', metavar='NAME,NAME', help=f'some of {",".join(campaign.RUNS)}')
    parser.add_argument('--hold', type=float, default=record.hold, metavar='S')
    parser.add_argument('--static-rate', type=float, default=record.static_rate, metavar='HZ')
    parser.add_argument('--duration', type=float, default=record.duration, metavar='S')
    parser.add_argument('--dynamic-rate', type=float, default=record.dynamic_rate, metavar='HZ')
    return parser


if __name__ == '__main__':
    sys.exit(main())


MAX_GROUP = 4
"""A group of more look-alikes than this is no answer."""


def score(
    kind: str, hidden: Sequence[str], verdict: str, groups: Sequence[Sequence[str]]
) -> tuple[str, int]:
    """How a verdict counts, and how many hidden effects are in its groups.

    right: every group holds a hidden effect, none is larger than four, and all effects are found;
    part: the same with some not found; wrong: a single name that is not hidden, beside a right one
    too; missed: `none` for something; false: anything on a clean rig; unknown: said of an effect
    of the catalogue; vague: groups too large or that miss.
    """
    found = sum(any(name in group for group in groups) for name in hidden)
    if kind == campaign.CLEAN:
        return ('right' if verdict == 'none' else 'false'), 0
    if verdict == 'none':
        return 'missed', 0
    if verdict == 'unknown':
        return ('right' if kind == OUTSIDE else 'unknown'), found
    strays = [group for group in groups if not any(name in group for name in hidden)]
    if strays:
        return ('wrong' if any(len(group) == 1 for group in strays) else 'vague'), found
    if any(len(group) > MAX_GROUP for group in groups):
        return 'vague', found
    return ('right' if found == len(hidden) else 'part'), found


@dataclass(frozen=True)
class Promise:
    """How often verdicts of some kinds of rig may (or must) have a score."""

    words: str
    kinds: tuple[str, ...]
    score: str
    rate: float
    is_minimum: bool


PROMISES = (
    Promise('sound rigs with a cause', (campaign.CLEAN,), 'false', 0.02, False),
    Promise('faults with a wrong name', (campaign.SINGLE, campaign.PAIR, OUTSIDE), 'wrong', 0.02,
            False),
    Promise('single effects found', (campaign.SINGLE,), 'right', 0.8, True),
    Promise('effects outside the catalogue called unknown', (OUTSIDE,), 'right', 0.85, True),
)
CHANCE = 1e-3
"""At which a program that just keeps a promise fails it."""


def broken_promises(scores: Sequence[tuple[str, str]]) -> list[str]:
    """Return each promise that a campaign of (kind, score) breaks, in words with its figures."""
    broken = []
    for promise in PROMISES:
        own = [score for kind, score in scores if kind in promise.kinds]
        count = own.count(promise.score)
        unlikely = (binom.cdf(count, len(own), promise.rate) if promise.is_minimum
                    else binom.sf(count - 1, len(own), promise.rate))
        if own and unlikely < CHANCE:
            broken.append(f'{promise.words}: {count} of {len(own)}, promised '
                          f'{"at least" if promise.is_minimum else "at most"} {promise.rate:.0%}')
    return broken
