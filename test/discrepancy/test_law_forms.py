"""Claims on forms of a law that compete with a second cause for what the law leaves."""

from bench import LOAD, recorded, STEP, System, TIME
import numpy as np

from saddlering_ros import discrepancy
from saddlering_ros.discrepancy import Diagnosis, Effect, Parameter, Point, Problem

NOISE = 5e-4
SIZE, TIME_CONSTANTS = 0.3, (0.25, 4.0)
BEND = 0.012
"""A second cause a fifth as large as was needed when a share of the first one was form error."""


def lagged(load: np.ndarray, time: float) -> np.ndarray:
    """A load (N,) behind a first-order lag."""
    seen, kept = np.zeros(load.size), np.exp(-STEP / time)
    for number in range(1, load.size):
        seen[number] = kept * seen[number - 1] + (1.0 - kept) * load[number]
    return seen


class Film(System):
    """A channel straight in the load; a film creeps with one time constant, a beam bends."""

    effects = (
        Effect('creep', {
            'size': Parameter(0.0, 1.0),
            'time': Parameter(0.05, 50.0, scale='log', start=1.0)}),
        Effect('bend', {'size': Parameter(-0.5, 0.5)}))

    def predict(self, name: str, point: Point) -> np.ndarray:
        seen = point.base[0] * LOAD
        for effect, values in point.effects.items():
            own = LOAD**2 if effect == 'bend' else lagged(LOAD, values['time'])
            seen = seen + values['size'] * own
        return seen[None, :]


def measured(bend: float, sway: float) -> np.ndarray:
    """What is seen of a film with two time constants, a bend, and a sway in no catalogue."""
    films = [lagged(LOAD, time) for time in TIME_CONSTANTS]
    seen = LOAD + SIZE * np.mean(films, axis=0) + bend * LOAD**2
    seen = seen + sway * np.sin(2.0 * np.pi * (TIME - 4.0) / 5.0) * (LOAD > 0.0)
    return (seen + np.random.default_rng(1).normal(0.0, NOISE, LOAD.size))[None, :]


def diagnosed(bend: float = 0.0, sway: float = 0.0) -> Diagnosis:
    return discrepancy.diagnose_system(Problem(Film(), [recorded('slow', measured(bend, sway))]))


def names(found: Diagnosis) -> set[str]:
    return {cause.effect for cause in found.causes}


def test_a_mixture_of_laws_of_one_kind_is_named_and_gets_no_second_name() -> None:
    found = diagnosed()
    assert (found.verdict, names(found)) == ('named', {'creep'})
    assert any('idealised' in note for note in found.warnings)


def test_a_second_cause_is_named_beside_a_mixture_that_the_catalogue_does_not_have() -> None:
    assert names(diagnosed(bend=BEND)) == {'creep', 'bend'}


def test_a_cause_is_partial_if_no_form_of_its_law_explains_the_rest() -> None:
    found = diagnosed(sway=0.003)
    assert (found.verdict, names(found)) == ('unknown', {'creep'})
    assert all(cause.partial for cause in found.causes)
