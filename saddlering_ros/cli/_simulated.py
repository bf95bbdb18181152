"""Samples of `simulate` and `residual`, stretch by stretch, so that a long run is not kept."""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterator
from itertools import chain

import numpy as np

from saddlering_ros.bags.samples import DisplacementSamples, measured_rows
from saddlering_ros.bags.scan import OnShare
from saddlering_ros.cli._arguments import take_effects
from saddlering_ros.cli._samples import check_outputs, deliver, read_shown
from saddlering_ros.cli._terminal import Bar
from saddlering_ros.record import Record
from saddlering_ros.record.measured import zero_of_run
from saddlering_ros.record.scratch import BLOCK, forget
from saddlering_ros.record.validity import BRIDGED, DOUBTFUL_LOAD
from saddlering_ros.rig import (
    CHANNELS,
    Displacement,
    load_rig,
    ParameterSet,
    read_parameters,
    Rig,
    ZeroReading,
)
from saddlering_ros.ring import SimulationError
from saddlering_ros.ring.simulator import simulate_in_blocks, SimulatedRun

Parts = Iterator[DisplacementSamples]

SamplesOf = Callable[[Rig, Record, ParameterSet, list[str], OnShare], tuple[Parts, ZeroReading]]


def deliver_simulation(args: argparse.Namespace, samples_of: SamplesOf, what: str) -> int:
    """Read the bag, compute its samples stretch by stretch, and deliver them as `what`."""
    check_outputs(args)
    take_effects(args)
    rig, parameters = load_rig(args.rig), read_parameters(args.params)
    test_run = read_shown(args, rig)
    notes = list(test_run.notes)
    with Bar() as bar:
        samples, zero = samples_of(
            rig, test_run, parameters, notes, lambda share: bar.show('simulate', share))
        deliver(args, test_run, samples, zero, what, notes)
    return 0


def simulated_samples(
    rig: Rig, run: Record, parameters: ParameterSet, notes: list[str], on_progress: OnShare,
) -> tuple[Parts, ZeroReading]:
    """The output of the live simulator for a run in stretches, and its zero.

    Notes on the simulation are appended to `notes`, the last of them after the last sample.
    """
    stretches = _stretches(rig, run, parameters, notes, on_progress)
    zero, first = next(stretches)
    return (samples.rows(samples.is_finite) for _, samples in chain([(zero, first)], stretches)
            ), zero


def residual_samples(
    rig: Rig, run: Record, parameters: ParameterSet, notes: list[str], on_progress: OnShare,
) -> tuple[Parts, ZeroReading]:
    """Measured minus simulated displacement where both have a sample, as the node gives it."""
    zero = zero_of_run(rig, run)
    stretches = _stretches(rig, run, parameters, notes, on_progress)
    first = next(stretches)
    return (_difference(rig, run, zero, samples)
            for _, samples in chain([first], stretches)), zero


def _stretches(
    rig: Rig, run: Record, parameters: ParameterSet, notes: list[str], on_progress: OnShare,
) -> Iterator[tuple[ZeroReading, DisplacementSamples]]:
    """The simulated samples, NaN where a step failed; SimulationError if there is none at all.

    Nothing comes before a stretch with a sample, so that a ring without one writes no output.
    """
    held, failed = [], 0
    found = False
    for simulated in simulate_in_blocks(
            rig, parameters, run.elevation, run.time, run.load, BLOCK):
        samples = _samples(run, simulated)
        failed = simulated.failed_steps
        held.append((simulated.zero, samples))
        found = found or bool(samples.is_finite.any())
        if found:
            yield from held
            held = []
        forget(run.stamps, run.time, run.load, run.gaps)
        on_progress((simulated.first + len(samples)) / len(run.time))
        zero = simulated.zero
    if not found:
        raise SimulationError(f'{run.path}: no sample could be simulated: the solver finds no '
                              'equilibrium of this ring: check contact.K1 and contact.K2 of the '
                              'parameter file, and the rig file')
    if failed:
        notes.append(f'the solver did not converge in {failed} steps: their samples are left out')
    if not zero.near_preload:
        notes.append('the record has no steady start near the preload; its zero is at another '
                     'load')


def _samples(run: Record, simulated: SimulatedRun) -> DisplacementSamples:
    rows = slice(simulated.first, simulated.first + len(simulated.time))
    validity = np.zeros(len(simulated.time), np.uint8)
    if run.node_rows is not None:
        validity[run.node_rows.load_bridged[rows]] |= BRIDGED
        validity[run.node_rows.load_doubtful[rows]] |= DOUBTFUL_LOAD
    return DisplacementSamples(
        run.stamps[rows], simulated.time, run.load[rows], simulated.displacement, validity)


def _difference(
    rig: Rig, run: Record, zero: ZeroReading, simulated: DisplacementSamples,
) -> DisplacementSamples:
    if not len(simulated):
        return simulated
    start = int(np.searchsorted(run.stamps, simulated.stamps[0]))
    measured, given = measured_rows(rig, run, zero, slice(start, start + len(simulated)))
    left = Displacement(**{
        name: (np.asarray(getattr(measured.displacement, name))
               - np.asarray(getattr(simulated.displacement, name))) for name in CHANNELS})
    return DisplacementSamples(
        measured.stamps, measured.time, measured.load, left,
        measured.validity | simulated.validity).rows(given & simulated.is_finite)
