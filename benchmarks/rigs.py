"""Rigs of the benchmarks: drawn contact laws and tests, runs of the virtual rig, sound bags."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from saddlering_ros.bags.write import write_bag
from saddlering_ros.record.record import RawRecord, RawTopic, Record, TestMetadata
from saddlering_ros.record.topics import LOAD_TOPIC, PROBE_TOPICS
from saddlering_ros.rig import default_rig, Displacement, FULL_SCALE_LOAD, ParameterSet, Rig, TONNE
from saddlering_ros.rig.description import Probes
from saddlering_ros.rig.geometry import displacement_to_probes
from saddlering_ros.rig.parameter_file import ContactParameters, TRUE_TO_SCALE
from saddlering_ros.ring.simulator import simulate, static_response
from saddlering_ros.virtual_rig import experiment
from saddlering_ros.virtual_rig.integrator import Scatter

RIG = default_rig()
NO_SCATTER = Scatter(gap=0.0, stiffness=0.0)
BEGIN = 1_700_000_000_000_000_000
"""Stamp [ns] of the first sample of a bag."""

MAX_READING = 0.8e-3
"""Probe reading [m] that a drawn rig may reach; the probes' span ends at 1 mm."""


def sized_rig(tonnes: float, rollers: int, radius: float) -> Rig:
    """The shipped rig with a cylinder of `tonnes` and rows on a circle of `radius` [m]."""
    usual = default_rig()
    size, scale = radius / usual.axial_rows.pitch_radius, tonnes * TONNE / FULL_SCALE_LOAD
    body = usual.carriage
    return replace(
        usual,
        axial_rows=replace(usual.axial_rows, rollers=rollers, pitch_radius=radius),
        radial_row=replace(usual.radial_row, rollers=rollers, pitch_radius=radius),
        carriage=replace(body, mass=body.mass * scale, weight=body.weight * scale,
                         inertia=body.inertia * scale * size**2),
        trunnion=replace(usual.trunnion, x=usual.trunnion.x * size, y=usual.trunnion.y * size),
        probes=replace(usual.probes, axial_span=usual.probes.axial_span * size),
        preload=usual.preload * scale, full_scale_load=tonnes * TONNE)


def as_read(
    record: experiment.TestRecord, probes: Probes, facts: TestMetadata, name: str,
) -> RawRecord:
    """A record of the virtual rig as the reader finds it in a bag called `name`."""
    topics = {LOAD_TOPIC: RawTopic(LOAD_TOPIC, '', '', record.load_stamps, record.load)}
    for topic, stamps, gaps in zip(PROBE_TOPICS, record.probe_stamps, record.gaps, strict=True):
        values = gaps.astype(np.float32).astype(np.float64)  # as a Range carries them
        topics[topic] = RawTopic(topic, '', '', stamps, values, probes.min_range, probes.max_range)
    return RawRecord(Path(name), topics, facts)


def drawn_contact(random: np.random.Generator, rig: Rig = RIG) -> ContactParameters:
    """A contact law from the whole box of bounds that the probes can follow at both elevations.

    K and D are drawn even in the logarithm, n even. The softest corner of the box moves the ring
    by more than the probes' span and is drawn again.
    """
    while True:
        contact = _drawn(random, rig)
        readings = [
            np.abs(_probe_readings(rig, contact, elevation)).max() for elevation in (50.0, 70.0)
        ]
        if max(readings) < MAX_READING:
            return contact


def _probe_readings(rig: Rig, contact: ContactParameters, elevation_deg: float) -> np.ndarray:
    loads = np.array([rig.preload, rig.full_scale_load])
    q = static_response(rig, contact.to_array(), np.radians(elevation_deg), loads)
    moved = q[:, 1] - q[:, 0]
    return displacement_to_probes(rig.probes, Displacement(moved[0], moved[1], moved[2], 0.0))


def _drawn(random: np.random.Generator, rig: Rig) -> ContactParameters:
    values = {}
    for name, (low, high) in rig.bounds.items():
        share = random.uniform(0.05, 0.95)
        even = low + share * (high - low)
        values[name] = even if name[0] == 'n' else low * (high / low) ** share
    return ContactParameters(**values)


def virtual_run(
    test: str, elevation_deg: float, contact: ContactParameters, *, seed: int,
    noise: float = 0.3e-6, scatter: Scatter = NO_SCATTER, rate: float | None = None,
    rig: Rig = RIG, number: int = 1, quantised: bool = True, **schedule: Any,
) -> Record:
    """One test on the virtual rig, as `bags` would align it; noise is the rms of a probe [m];
    number: of the rig, whose rollers it draws; quantised: whether readings have steps;
    schedule: options of that of the load. The load cell suits the size of the rig."""
    physical = experiment.PhysicalRig(rig, contact, float(np.radians(elevation_deg)),
                                      scatter=scatter, number=number)
    make = experiment.static_schedule if test == 'static' else experiment.dynamic_schedule
    load_noise = experiment.Instruments.load_noise * rig.full_scale_load / FULL_SCALE_LOAD
    record = experiment.record_test(experiment.TestPlan(
        physical, make(rig, **schedule), seed=seed, rate=rate, instruments=experiment.Instruments(
            noise=noise, load_noise=load_noise, quantised=quantised)))
    stamps = record.load_stamps
    time = (stamps - stamps[0]) * 1e-9
    gaps = np.stack([
        np.interp(time, (own - stamps[0]) * 1e-9, gap, left=np.nan, right=np.nan)
        for own, gap in zip(record.probe_stamps, record.gaps, strict=True)
    ])
    name = f'{test}_{elevation_deg:g}_{seed}'
    return Record(
        name=name, path=Path(name), test=test, elevation=float(np.radians(elevation_deg)),
        rig='virtual', run=str(seed), stamps=stamps, time=time, load=record.load, gaps=gaps,
        notes=[],
    )


def course(seconds: float, rate: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Time (N,) [s], load (N,) [N] and gaps (4, N) [m] of a sound ring at 50 degrees.

    The load rests for at most a second, rises in a straight line, falls and rests again.
    """
    times = np.arange(round(seconds * rate)) / rate
    rest = min(1.0, seconds / 8.0)
    near_an_end = np.minimum(times - rest, seconds - rest - times) / (0.5 * seconds - rest)
    load = RIG.preload + 235e3 * np.clip(near_an_end, 0.0, 1.0)
    moved = simulate(RIG, ParameterSet(TRUE_TO_SCALE), np.radians(50.0), times, load).probes
    gaps = 1e-3 + np.asarray(RIG.probes.polarity)[:, None] * moved
    return times, load, np.float64(np.float32(gaps))


def course_bag(folder: Path, seconds: float, rate: float, **options: Any) -> Path:
    """A bag of a course with noise on the probes; options of `write_bag`."""
    times, load, gaps = course(seconds, rate)
    stamps = BEGIN + np.round(times * 1e9).astype(np.int64)
    gaps += np.random.default_rng(0).normal(0.0, 3e-7, gaps.shape)
    return write_bag(folder / 'bag', TestMetadata('dynamic', 50.0), stamps, load,
                     [stamps + 100_000 * probe for probe in range(4)],
                     list(np.float64(np.float32(gaps))), RIG.probes, **options)
