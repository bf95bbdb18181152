"""Does the judgement of a fleet find hidden drifts, odd rings and bad rigs?

    python benchmarks/fleet.py [--rings 200] [--sessions 8] [--fleets 10] [--seed 0]

What sessions report (values with covariances) is simulated, not bags: clean rings, rings unlike
their sisters, rings whose axial stiffness wears with service hours, rigs whose load cell drifts,
and rings with a cause of the catalogue.
"""

import os

os.environ.setdefault('OPENBLAS_NUM_THREADS', '1')

from collections.abc import Mapping, Sequence

from frame import arguments, table
import numpy as np

from saddlering_ros.fleet.attention import judge_fleet
from saddlering_ros.fleet.history import YEAR
from saddlering_ros.fleet.statistics import COORDINATES, SessionFigures

MEAN = np.array([17.45, 1.11, 14.9, 17.45, 1.11, 14.9])
BETWEEN = np.array([0.06, 0.006, 0.10, 0.06, 0.006, 0.10])
WITHIN = np.array([0.012, 0.004, 0.03, 0.012, 0.004, 0.03])
"""Spread of sound rings and error of one session in COORDINATES."""

COVARIANCE = np.diag(WITHIN**2)
COVARIANCE[[0, 1, 3, 4], [1, 0, 4, 3]] = -0.5 * (WITHIN[0] * WITHIN[1])
"""Of the error of a session; its stiffness and exponent have a correlation of -0.5."""

SOUND, UNLIKE, WEARING, CAUSE = 'sound', 'unlike', 'wearing', 'cause'
WEAR = -0.05
"""Change of log stiffness of a wearing ring over its whole history, a session."""

CELL_DRIFT = -0.02
"""Change of the logarithm of every stiffness and damping a session, on a rig that drifts."""


RIGS, BAD_RIG = 10, 'rig-0'
"""Rigs of a fleet, and the one whose load cell drifts."""

Truth = Mapping[str, tuple[str, str]]
"""What is hidden: the kind of every ring, and its rig."""


def draw_fleet(rings: int, sessions: int, seed: int) -> tuple[list[SessionFigures], Truth]:
    """Sessions of a fleet, and what is hidden in it."""
    chance, root = np.random.default_rng(seed), np.linalg.cholesky(COVARIANCE)
    truth, found = {}, []
    for number in range(rings):
        ring, rig = f'SR-{number:04d}', f'rig-{number % RIGS}'
        kind = chance.choice([SOUND, UNLIKE, WEARING, CAUSE], p=[0.82, 0.06, 0.06, 0.06])
        truth[ring] = str(kind), rig
        mean = MEAN + BETWEEN * chance.standard_normal(6)
        if kind == UNLIKE:
            mean[int(chance.choice([0, 2, 3, 5]))] += float(chance.choice([-1, 1])) * 0.6
        first = float(chance.uniform(0.0, 0.5))
        for session in range(sessions):
            value = mean + root @ chance.standard_normal(6)
            if kind == WEARING:
                value[0] += WEAR * session
            if rig == BAD_RIG:
                value[[0, 2, 3, 5]] += CELL_DRIFT * session
            p_value = float(chance.uniform())
            caused = kind == CAUSE and chance.uniform() < 0.9
            if caused:
                p_value = float(10.0 ** -chance.uniform(4.0, 12.0))
            verdict = 'named' if p_value < 0.01 else 'none'
            years = 2026.0 - 1970.0 + first + 0.5 * session
            found.append(SessionFigures(
                f'{ring}-{session}', f'{ring} {session}', ring, rig, years * YEAR,
                400.0 * (session + first), False, verdict,
                p_value if verdict == 'named' else 1.0, value, COVARIANCE,
                {'radial_friction': (5e3, 200.0)} if caused else {}))
    return found, truth


def score(sessions: Sequence[SessionFigures], truth: Truth) -> dict[str, tuple[int, int]]:
    """(counted, of) for every rate of the table."""
    fleet = judge_fleet(sessions)
    drifting = {item.ring for item in fleet.rings if item.drift is not None}
    unlike = {item.ring for item in fleet.rings if item.unlike and item.unlike.stands}
    findings = {item.ring for item in fleet.rings if item.finding}
    blamed = {item.owner for item in fleet.rigs}
    single = [item.ring for item, real in zip(fleet.sessions, fleet.session_stands, strict=True)
              if real]

    def rings(kind: str) -> set[str]:
        return {ring for ring, (own, _) in truth.items() if own == kind}

    on_bad = {ring for ring, (_, rig) in truth.items() if rig == BAD_RIG}
    inside, predicted = 0, 0
    for item in fleet.rings:
        for history in item.history.of.values():
            inside += round(history.coverage * history.predictions) if history.predictions else 0
            predicted += history.predictions
    return {
        'findings of sessions that are false': (
            sum(truth[ring][0] != CAUSE for ring in single), len(single)),
        'rings with a cause found': (len(findings & rings(CAUSE)), len(rings(CAUSE))),
        'findings of rings that are false': (len(findings - rings(CAUSE)), len(findings)),
        'unlike rings found': (len(unlike & rings(UNLIKE)), len(rings(UNLIKE))),
        'rings called unlike that are sound': (
            len(unlike - rings(UNLIKE) - rings(WEARING) - on_bad), len(unlike)),
        'wearing rings found': (len(drifting & rings(WEARING)), len(rings(WEARING))),
        'drifts of rings that are false': (len(drifting - rings(WEARING)), len(drifting)),
        'rings of the drifting rig blamed for it': (
            len(drifting & on_bad - rings(WEARING)), len(on_bad - rings(WEARING))),
        'drifting rigs blamed': (len(blamed & {BAD_RIG}), 1),
        'sound rigs blamed': (len(blamed - {BAD_RIG}), RIGS - 1),
        'predictions inside their 95 % interval': (inside, predicted),
    }


def main() -> None:
    args = arguments(__doc__, {'fleets': 1, 'rings': 50}, rings=200, sessions=8, fleets=10, seed=0)
    total: dict[str, tuple[int, int]] = {}
    for number in range(args.fleets):
        sessions, truth = draw_fleet(args.rings, args.sessions, args.seed + number)
        for name, (count, of) in score(sessions, truth).items():
            before = total.get(name, (0, 0))
            total[name] = before[0] + count, before[1] + of
    table(f'{args.fleets} fleets of {args.rings} rings with {args.sessions} sessions each; '
          f'coordinates {", ".join(COORDINATES)}', ('figure', 'counted', 'of'),
          [(name, *counts) for name, counts in total.items()])


if __name__ == '__main__':
    main()
