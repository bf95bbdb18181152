"""A campaign on one virtual rig: its hidden causes are drawn, then its bags are made."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass, field
import math
from pathlib import Path
from typing import Any

import numpy as np

from saddlering_ros.errors import VirtualRigError
from saddlering_ros.rig import ContactParameters, default_rig, Rig, size_factor, TRUE_TO_SCALE
from saddlering_ros.virtual_rig import recording
from saddlering_ros.virtual_rig.effects import EffectRequest, EFFECTS, request, RigEffect, TrueSize
from saddlering_ros.virtual_rig.integrator import Scatter
from saddlering_ros.virtual_rig.physics import PhysicalRig
from saddlering_ros.virtual_rig.recording import Instruments, record_test, TestPlan, write_record
from saddlering_ros.virtual_rig.schedule import dynamic_schedule, static_schedule

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
    instruments: Instruments

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
    if kind not in KINDS:
        raise VirtualRigError(f'kind is {kind!r}: give one of {", ".join(KINDS)}')
    if seed < 0:
        raise VirtualRigError(f'seed is {seed}: give a whole number from 0 up')
    settings, rig = settings or DrawSettings(), rig or default_rig()
    chance = np.random.default_rng([seed, KINDS.index(kind)])
    noise = math.exp(chance.uniform(math.log(0.2e-6), math.log(0.45e-6)))
    contact, scatter = _draw_contact(chance), Scatter(float(chance.uniform(0.5e-6, 1e-6)), 0.02)
    load_noise = size_factor('N', rig) * float(chance.uniform(20.0, 90.0))
    instruments = Instruments(noise=settings.noise or noise, load_noise=load_noise)
    drawn = _draw_effects(chance, kind, settings)
    requests = tuple(_draw_request(chance, effect, settings, rig) for effect in drawn)
    return Truth(seed, kind, contact, requests, scatter, instruments)


def write_campaign(truth: Truth, out: Path, runs: Sequence[str] = tuple(RUNS),
                   settings: RecordSettings | None = None, rig: Rig | None = None, *,
                   overwrite: bool = False) -> list[Path]:
    """Carry out the runs on the rig of `truth` and write their bags into the folder `out`."""
    unknown = [name for name in runs if name not in RUNS]
    if unknown:
        raise VirtualRigError(f'run {unknown[0]!r} does not exist: give some of {", ".join(RUNS)}')
    rig = rig or default_rig()
    settings = settings or RecordSettings()
    return [
        write_record(out / name, record_test(plan_run(truth, RUNS[name], settings, rig)), rig,
                     overwrite=overwrite)
        for name in runs
    ]


def plan_run(truth: Truth, run: RunPlan, settings: RecordSettings, rig: Rig) -> TestPlan:
    """The plan of one run on the rig of `truth`."""
    physical = PhysicalRig(rig, truth.contact, math.radians(run.elevation_deg), truth.effects,
                           truth.scatter, truth.seed)
    if run.test == 'static':
        schedule, rate = static_schedule(rig, hold=settings.hold), settings.static_rate
    else:
        schedule = dynamic_schedule(rig, duration=settings.duration, speed=run.speed,
                                    rest=settings.rest)
        rate = settings.dynamic_rate
    number = list(RUNS).index(run.name)
    seed = int(np.random.SeedSequence([truth.seed, number]).generate_state(1)[0])
    begin = recording.EPOCH + 3600 * (truth.seed % HOURS) + BETWEEN_RUNS * number
    return TestPlan(physical, schedule, seed, truth.instruments, rate, rig_name='virtual rig',
                    run_name=run.name, begin=begin)


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
    named = [name for name in settings.effects if name not in EFFECTS]
    if named:
        raise VirtualRigError(f'effect {named[0]!r} does not exist: there are '
                              f'{", ".join(sorted(EFFECTS))}')
    pool = [effect for name, effect in sorted(EFFECTS.items())
            if effect.in_catalogue == (kind != OUTSIDE)
            and (not settings.effects or name in settings.effects)]
    if len(pool) < (2 if kind == PAIR else 1):
        raise VirtualRigError(f'too few effects are left to draw a {kind} from: name others')
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
