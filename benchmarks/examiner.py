"""The examiner: draws a rig with hidden faults, writes its bags, seals the truth, prints the seal.

    python benchmarks/examiner.py --seed N --out DIR

It runs as a process of its own, writes DIR/<run>/ (bags) and DIR/truth.sealed, and prints one line
of JSON with the bags and the SHA-256 of the sealed file. `open_seal` gives the truth to who can
show that digest. The score of a verdict after the seal is opened stands here too: benchmarks and
tests share this rule.
"""

import argparse
import base64
from collections.abc import Sequence
from dataclasses import asdict, dataclass, field
import json
import math
from pathlib import Path
from typing import Any
import zlib

import numpy as np
from scipy.special import bdtr, bdtrc

from saddlering_ros.errors import VirtualRigError
from saddlering_ros.files import sha256_of_file, write_text
from saddlering_ros.rig import ContactParameters, default_rig, Rig, TRUE_TO_SCALE
from saddlering_ros.rig.geometry import size_factor
from saddlering_ros.virtual_rig import experiment
from saddlering_ros.virtual_rig.effects import EffectRequest, EFFECTS, request, RigEffect, TrueSize
from saddlering_ros.virtual_rig.integrator import Scatter

CLEAN, SINGLE, PAIR, OUTSIDE = 'clean', 'single', 'pair', 'outside'
KINDS = (CLEAN, SINGLE, PAIR, OUTSIDE)
"""No effect; one of the catalogue; two of the catalogue; one that is in no catalogue."""

REFERENCE_PENETRATION = 1e-4
"""Penetration [m] at which stiffness is compared when the exponent is drawn too."""

HOURS = 20_000
BETWEEN_RUNS = 900
"""Hours within which campaigns begin, and seconds between their runs."""


@dataclass(frozen=True)
class RunPlan:
    """One run of a campaign: its name, kind, elevation [deg], speed of a dynamic ramp."""

    name: str
    test: str
    elevation_deg: float
    speed: float = 1.0


RUNS: dict[str, RunPlan] = {
    plan.name: plan for plan in (
        RunPlan('static_50', 'static', 50.0), RunPlan('dynamic_50', 'dynamic', 50.0),
        RunPlan('dynamic_50_fast', 'dynamic', 50.0, 4.0), RunPlan('static_70', 'static', 70.0),
        RunPlan('dynamic_70', 'dynamic', 70.0),
    )
}
"""The runs of the shipped bags."""


@dataclass(frozen=True)
class Truth:
    """The truth: effects, contact law, roller scatter, noise, and their seed."""

    seed: int
    kind: str
    contact: ContactParameters
    effects: tuple[EffectRequest, ...]
    scatter: Scatter
    instruments: experiment.Instruments

    def to_json(self) -> dict[str, Any]:
        """Everything as plain numbers and texts (SI units)."""
        return {
            'seed': self.seed, 'kind': self.kind,
            'effects': [
                {'effect': item.effect.id, 'form': item.form, 'parameters': dict(item.values)}
                for item in self.effects
            ],
            'contact': asdict(self.contact), 'scatter': asdict(self.scatter),
            'instruments': asdict(self.instruments),
        }


@dataclass(frozen=True)
class RecordSettings:
    """How runs are recorded: static hold [s] and rate [Hz], dynamic duration [s] and rate [Hz].

    rest [s]: of a dynamic run before and after its ramps; None: as its duration has it.
    """

    hold: float = 5.0
    static_rate: float = 25.0
    duration: float = 10.0
    dynamic_rate: float = 1000.0
    rest: float | None = None


@dataclass(frozen=True)
class DrawSettings:
    """Range of a draw: effects (none: all of the kind), part of their sizes, noise [m].

    sizes: low and high end on a logarithmic scale from 0, smallest plausible size, to 1, largest.
    fixed: parameters not left to chance, per effect.
    """

    effects: tuple[str, ...] = ()
    sizes: tuple[float, float] = (0.3, 1.0)
    noise: float | None = None
    fixed: dict[str, dict[str, float]] = field(default_factory=dict)


def draw_truth(seed: int, kind: str, settings: DrawSettings | None = None,
               rig: Rig | None = None) -> Truth:
    """Draw the faults of a rig (default: the shipped one); the same arguments give the same draw.

    Forces, moments and compliances that are drawn follow the size of the rig.
    """
    settings, rig = settings or DrawSettings(), rig or default_rig()
    chance = np.random.default_rng([seed, KINDS.index(kind)])
    noise = math.exp(chance.uniform(math.log(0.2e-6), math.log(0.45e-6)))
    contact, scatter = _draw_contact(chance), Scatter(float(chance.uniform(0.5e-6, 1e-6)), 0.02)
    load_noise = size_factor('N', rig) * float(chance.uniform(20.0, 90.0))
    instruments = experiment.Instruments(noise=settings.noise or noise, load_noise=load_noise)
    drawn = _draw_effects(chance, kind, settings)
    requests = tuple(_draw_request(chance, effect, settings, rig) for effect in drawn)
    return Truth(seed, kind, contact, requests, scatter, instruments)


def write_campaign(truth: Truth, out: Path, runs: Sequence[str] = tuple(RUNS),
                   settings: RecordSettings | None = None, rig: Rig | None = None, *,
                   overwrite: bool = False) -> list[Path]:
    """Carry out the runs on the rig of `truth` and write their bags into the folder `out`."""
    rig = rig or default_rig()
    settings = settings or RecordSettings()
    return [
        experiment.write_record(
            out / name, experiment.record_test(plan_run(truth, RUNS[name], settings, rig)), rig,
            overwrite=overwrite) for name in runs]


def plan_run(
    truth: Truth, run: RunPlan, settings: RecordSettings, rig: Rig,
) -> experiment.TestPlan:
    """The plan of one run on the rig of `truth`."""
    physical = experiment.PhysicalRig(rig, truth.contact, math.radians(run.elevation_deg),
                                      truth.effects, truth.scatter, truth.seed)
    if run.test == 'static':
        schedule, rate = experiment.static_schedule(rig, hold=settings.hold), settings.static_rate
    else:
        schedule = experiment.dynamic_schedule(rig, duration=settings.duration, speed=run.speed,
                                               rest=settings.rest)
        rate = settings.dynamic_rate
    number = list(RUNS).index(run.name)
    seed = int(np.random.SeedSequence([truth.seed, number]).generate_state(1)[0])
    begin = experiment.EPOCH + 3600 * (truth.seed % HOURS) + BETWEEN_RUNS * number
    return experiment.TestPlan(physical, schedule, seed, truth.instruments, rate,
                               rig_name='virtual rig', run_name=run.name, begin=begin)


def _draw_contact(chance: np.random.Generator) -> ContactParameters:
    values = []
    for name in ('1', '2'):
        exponent = float(chance.uniform(1.06, 1.18))
        stiffness = getattr(TRUE_TO_SCALE, f'K{name}') * math.exp(chance.uniform(-0.3, 0.4))
        shift = REFERENCE_PENETRATION ** (getattr(TRUE_TO_SCALE, f'n{name}') - exponent)
        damping = math.exp(chance.uniform(math.log(1.5e6), math.log(6e6)))
        values += [stiffness * shift, exponent, damping]
    return ContactParameters(*values)


def _draw_effects(chance: np.random.Generator, kind: str,
                  settings: DrawSettings) -> list[RigEffect]:
    if kind == CLEAN:
        return []
    pool = [effect for name, effect in sorted(EFFECTS.items())
            if effect.in_catalogue == (kind != OUTSIDE)
            and (not settings.effects or name in settings.effects)]
    first = pool[int(chance.integers(len(pool)))]
    if kind != PAIR:
        return [first]
    others = [effect for effect in pool if effect is not first]
    apart = [effect for effect in others
             if effect.stage != first.stage and set(effect.channels) != set(first.channels)]
    others = apart or others
    return [first, others[int(chance.integers(len(others)))]]


def _draw_request(chance: np.random.Generator, effect: RigEffect,
                  settings: DrawSettings, rig: Rig) -> EffectRequest:
    form = effect.forms[int(chance.integers(len(effect.forms)))]
    main, *rest = effect.parameters_on(rig)
    share = float(chance.uniform(*settings.sizes))
    size = float(main.low * (main.high / main.low) ** share)
    values = {main.name: (-size if main.signed and chance.random() < 0.5 else size)}
    values.update({parameter.name: _draw_value(chance, parameter) for parameter in rest})
    if 'side' in values:  # a probe can only run into the limit that it moves towards
        values['side'] = 1.0 if values['probe'] in (1.0, 2.0) else -1.0
    values.update(settings.fixed.get(effect.id, {}))
    return request(effect.id, values, form, rig)


def _draw_value(chance: np.random.Generator, parameter: TrueSize) -> float:
    if parameter.choices:
        return float(chance.choice(np.array(parameter.choices)))
    if parameter.positive:
        low, high = math.log(parameter.low), math.log(parameter.high)
        return math.exp(chance.uniform(low, high))
    size = float(chance.uniform(parameter.low, parameter.high))
    return -size if parameter.signed and chance.random() < 0.5 else size


SEALED = 'truth.sealed'


def seal(path: Path, truth: Truth) -> str:
    """Write the truth so that no one reads it by accident; return the digest of the file."""
    text = json.dumps(truth.to_json(), sort_keys=True)
    write_text(path, base64.b85encode(zlib.compress(text.encode(), 9)).decode() + '\n')
    return sha256_of_file(path)


def open_seal(path: Path, digest: str) -> dict[str, Any]:
    """The truth of a sealed file; VirtualRigError if it is not the one that was sealed."""
    if sha256_of_file(path) != digest:
        raise VirtualRigError(f'{path}: the seal is broken: this is not the file that was sealed')
    truth: dict[str, Any] = json.loads(zlib.decompress(base64.b85decode(path.read_text().strip())))
    return truth


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
    if kind == CLEAN:
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
    Promise('sound rigs with a cause', (CLEAN,), 'false', 0.02, False),
    Promise('faults with a wrong name', (SINGLE, PAIR, OUTSIDE), 'wrong', 0.02, False),
    Promise('single effects found', (SINGLE,), 'right', 0.8, True),
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
        unlikely = (bdtr(count, len(own), promise.rate) if promise.is_minimum
                    else bdtrc(count - 1, len(own), promise.rate))
        if own and unlikely < CHANCE:
            broken.append(f'{promise.words}: {count} of {len(own)}, promised '
                          f'{"at least" if promise.is_minimum else "at most"} {promise.rate:.0%}')
    return broken


def main() -> None:
    """Draw, write, seal, print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('--seed', type=int, required=True)
    parser.add_argument('--out', type=Path, required=True)
    parser.add_argument('--kind', choices=KINDS, default=SINGLE)
    parser.add_argument('--effect', action='append', default=[], choices=sorted(EFFECTS))
    parser.add_argument('--sizes', type=float, nargs=2, default=DrawSettings.sizes)
    parser.add_argument('--runs', default=','.join(RUNS))
    for name, value in asdict(RecordSettings()).items():
        parser.add_argument(f'--{name.replace("_", "-")}', type=float, default=value)
    args = parser.parse_args()
    truth = draw_truth(args.seed, args.kind, DrawSettings(tuple(args.effect), tuple(args.sizes)))
    record = RecordSettings(**{name: getattr(args, name) for name in asdict(RecordSettings())})
    bags = write_campaign(truth, args.out, args.runs.split(','), record)
    digest = seal(args.out / SEALED, truth)
    print(json.dumps({'seed': args.seed, 'bags': [str(bag) for bag in bags], 'seal': digest}))


if __name__ == '__main__':
    main()
