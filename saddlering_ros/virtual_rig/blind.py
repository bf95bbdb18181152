"""The examiner: draws a rig with hidden faults, writes its bags, seals the truth, prints the seal.

Run it as a process of its own: `python -m saddlering_ros.virtual_rig.blind --seed N --out DIR`. It
writes DIR/<run>/ (bags) and DIR/truth.sealed, and prints one line of JSON with the bags and the
SHA-256 of the sealed file. `open_seal` gives the truth to who can show that digest.
"""

from __future__ import annotations

import argparse
import base64
from collections.abc import Sequence
import hashlib
import json
from pathlib import Path
import sys
from typing import Any
import zlib

from saddlering_ros.errors import SaddleringError
from saddlering_ros.rig import load_rig, write_text_atomically
from saddlering_ros.virtual_rig.campaign import (
    draw_truth,
    DrawSettings,
    KINDS,
    RecordSettings,
    RUNS,
    SINGLE,
    Truth,
    write_campaign,
)
from saddlering_ros.virtual_rig.effects import find_effect
from saddlering_ros.virtual_rig.errors import VirtualRigError

SEALED = 'truth.sealed'


def seal(path: Path, truth: Truth) -> str:
    """Write the truth so that no one reads it by accident; return the digest of the file."""
    text = json.dumps(truth.to_json(), sort_keys=True)
    sealed = base64.b85encode(zlib.compress(text.encode(), 9)).decode()
    write_text_atomically(path, sealed + '\n')
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
        rig = load_rig(args.rig)
        truth = draw_truth(args.seed, args.kind, _settings(args), rig)
        record = RecordSettings(args.hold, args.static_rate, args.duration, args.dynamic_rate)
        runs = args.runs.split(',') if args.runs else tuple(RUNS)
        bags = write_campaign(truth, args.out, runs, record, rig,
                              overwrite=args.overwrite)
        digest = seal(args.out / SEALED, truth)
    except SaddleringError as problem:
        print(f'blind: {problem}', file=sys.stderr)
        return 2
    print(json.dumps({'seed': args.seed, 'bags': [str(bag) for bag in bags], 'seal': digest}))
    return 0


def _settings(args: argparse.Namespace) -> DrawSettings:
    effects = tuple(find_effect(name).id for name in args.effect)
    if args.size is not None and len(effects) != 1:
        raise VirtualRigError('--size is the size of one effect: give exactly one --effect')
    fixed = {}
    if args.size is not None:
        fixed = {effects[0]: {find_effect(effects[0]).parameters[0].name: args.size}}
    forms = {effects[0]: args.form} if args.form and len(effects) == 1 else {}
    noise = None if args.noise is None else args.noise * 1e-6
    low, high = args.sizes
    if not -2.0 <= low <= high <= 2.0:
        raise VirtualRigError(f'--sizes are {low:g} {high:g}: give two numbers '
                              'from 0 to 1, low first')
    return DrawSettings(effects, tuple(args.exclude), (low, high), noise, fixed, forms)


def _parser() -> argparse.ArgumentParser:
    record = RecordSettings()
    parser = argparse.ArgumentParser(
        prog='python -m saddlering_ros.virtual_rig.blind', description=__doc__)
    parser.add_argument('--seed', type=int, required=True)
    parser.add_argument('--out', type=Path, required=True, metavar='DIR')
    parser.add_argument('--kind', choices=KINDS, default=SINGLE)
    parser.add_argument('--effect', action='append', default=[], metavar='NAME',
                        help='draw from these only (may be repeated)')
    parser.add_argument('--exclude', action='append', default=[], metavar='NAME',
                        help='never draw this one (may be repeated)')
    parser.add_argument('--size', type=float, help='size of the one --effect, SI units')
    parser.add_argument('--form', help='form of the one --effect')
    parser.add_argument('--sizes', type=float, nargs=2, default=(0.3, 1.0),
                        metavar=('LOW', 'HIGH'), help='part of the plausible sizes, 0 to 1')
    parser.add_argument('--noise', type=float, metavar='UM', help='rms noise of the probes')
    parser.add_argument('--runs', metavar='NAME,NAME', help=f'some of {",".join(RUNS)}')
    parser.add_argument('--hold', type=float, default=record.hold, metavar='S')
    parser.add_argument('--static-rate', type=float, default=record.static_rate, metavar='HZ')
    parser.add_argument('--duration', type=float, default=record.duration, metavar='S')
    parser.add_argument('--dynamic-rate', type=float, default=record.dynamic_rate, metavar='HZ')
    parser.add_argument('--rig', type=Path)
    parser.add_argument('--overwrite', action='store_true')
    return parser


if __name__ == '__main__':
    sys.exit(main())
