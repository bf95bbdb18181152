"""Claims about the budget of an identification with certificates."""

from dataclasses import replace
from pathlib import Path
import sys

import numpy as np
import pytest

from saddlering_ros.effects import effect, NO_EXTENSION
from saddlering_ros.identification.methods import identify
from saddlering_ros.identification.objective import changes_on, predict
from saddlering_ros.identification.observation import observe_prepared
from saddlering_ros.identification.prepared import prepare
from saddlering_ros.identification.uncertainty import IMPERFECTIONS
from saddlering_ros.rig import Instruments, PARAMETER_NAMES, TRUE_TO_SCALE
from saddlering_ros.ring.small_errors import CERTIFIED, certified_errors, DIMENSIONS, with_error

sys.path.insert(0, str(Path(__file__).parents[2] / 'benchmarks'))
from rigs import RIG, virtual_run


@pytest.fixture(scope='module')
def runs():
    return [virtual_run('static', 50.0, TRUE_TO_SCALE, seed=1),
            virtual_run('dynamic', 50.0, TRUE_TO_SCALE, seed=2)]


@pytest.fixture(scope='module')
def plain(runs):
    return identify(runs, RIG)


def test_a_certificate_widens_what_depends_on_it_by_its_own_size(runs, plain):
    stated = identify(runs, replace(RIG, instruments=Instruments(load_gain=2e-3)))
    # A load that is wrong by a share is, but for the weight, K1 and K2 wrong by that share.
    widened = np.sqrt(np.diag(stated.covariance) - np.diag(plain.covariance))
    contact = plain.parameters.contact.to_array()
    for index in (PARAMETER_NAMES.index('K2'), PARAMETER_NAMES.index('D2')):
        assert widened[index] / contact[index] == pytest.approx(2e-3, rel=0.35)
    assert np.allclose(stated.parameters.contact.to_array(), contact, rtol=1e-9)


def test_the_shares_of_the_budget_sum_to_one_and_name_each_source(runs):
    found = identify(runs, replace(RIG, instruments=Instruments(load_gain=2e-3, clearance=2e-6)))
    for shares in found.budget.values():
        assert sum(shares.values()) == pytest.approx(1.0)
        assert set(shares) == {'noise', 'unequal_rollers', 'load_gain', 'clearance_axial',
                               'clearance_radial'}


def test_a_gain_of_all_probes_alike_is_listed_as_a_refit_has_it(runs, plain):
    """At 10 % it moved K1 by 26 % while the fit was as good as that of a sound ring."""
    moved = identify([replace(run, gaps=1.005 * run.gaps - 0.005 * run.gaps[:, :1])
                      for run in runs], RIG)
    scale = np.array([name[0] == 'n' or getattr(plain.parameters.contact, name)
                      for name in PARAMETER_NAMES], np.float64)
    change = (moved.parameters.contact.to_array() - plain.parameters.contact.to_array()) / scale
    listed = plain.systematic['probe_gains']
    assert abs(listed[0]) > 0.003
    assert change == pytest.approx(listed, abs=1e-3)
    told = plain.to_json()['systematic']['probe_gains']
    assert told['K1'] == pytest.approx(np.expm1(listed[0]))
    assert told['n1'] == listed[1]


@pytest.mark.parametrize('absent', [0, 3])
def test_an_error_of_a_probe_moves_what_that_probe_reads(absent, runs):
    gains, height, span = (0.01, 0.02, 0.03, 0.04), 0.2, RIG.probes.axial_span
    rig = replace(RIG, instruments=Instruments(probe_gain=gains), probes=replace(
        RIG.probes, absent=absent, radial_height=height))
    [run] = observe_prepared([prepare(runs[1], rig, 4.0)], 4.0)
    contact = TRUE_TO_SCALE.to_array()
    x, y, gamma = predict(rig, contact[None], run)[0]
    x_share, parity = (1.0, 0.0) if absent else (0.5, 0.5)
    moved = {
        number: np.outer(shares, along) for number, shares, along in (
            (1, [x_share, 0.0, 0.0, parity], x + height * gamma),
            (2, [-height / span, 0.5, 1.0 / span, 0.0], y + 0.5 * span * gamma),
            (3, [x_share, 0.0, 0.0, -parity], x + height * gamma),
            (4, [height / span, 0.5, -1.0 / span, 0.0], y - 0.5 * span * gamma))}
    errors = certified_errors(rig)
    changes = changes_on(rig, contact, run, [with_error(rig, error) for error in errors.values()])
    # The prediction starts at rest at the zero, and a run at its first load: 2 nm at most.
    assert dict(zip(errors, changes, strict=True)) == {f'probe_gain_{number}': pytest.approx(
        gains[number - 1] * moved[number], rel=1e-3, abs=2e-9) for number in rig.probes.present}


def test_every_stated_error_is_what_the_effect_of_this_name_makes_of_it():
    """An effect may be taken out of the catalogue, and identification knows its errors still."""
    rig = replace(RIG, instruments=Instruments(**{
        entry: 1e-3 for entry, _, _ in CERTIFIED.values()}))
    errors = {**IMPERFECTIONS, **certified_errors(rig)}
    of_effects = [error for error in errors.values() if not {*error} & {*DIMENSIONS}]
    assert len(of_effects) > 15
    for error in of_effects:
        (name, values), = error.items()
        cause = effect(name)
        assert with_error(rig, error)[1] == cause.extend(
            NO_EXTENSION, {**cause.complete({}), **values})
