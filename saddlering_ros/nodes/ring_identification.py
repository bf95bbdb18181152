"""Node ring_identification: the action /identify_ring, contact parameters from recorded bags."""

import math
from typing import Any

from saddlering_interfaces.action import IdentifyRing
from saddlering_ros.identification.settings import IdentificationSettings, SwarmSettings
from saddlering_ros.jobs.action_server import ActionNode, serve
from saddlering_ros.jobs.requests import IdentificationRequest
from saddlering_ros.progress import Progress, SearchStep
from saddlering_ros.rig import PARAMETER_NAMES
from saddlering_ros.ros.names import IDENTIFY, NodeError
from saddlering_ros.ros.streaming_node import executable

SWARM_FIELDS = {
    'particles': ('particles', 10_000), 'iterations': ('iterations', 10_000_000),
    'c1': ('cognitive', 10.0), 'c2': ('social', 10.0), 'inertia_start': ('inertia_start', 10.0),
    'inertia_end': ('inertia_end', 10.0)}
"""Fields of the goal, the settings of the swarm they are, and their largest values: a goal cannot
take unlimited memory or time."""

SHARES = {'read': (0.0, 0.05), 'identify': (0.05, 0.9), 'validate': (0.9, 1.0)}
"""Part of a goal that each task is, from and to; by the time that they usually take."""


class RingIdentificationNode(ActionNode):
    """Serves /identify_ring."""

    NODE = 'ring_identification'
    ACTION = IdentifyRing
    NAME = IDENTIFY

    def request(self, goal: IdentifyRing.Goal) -> IdentificationRequest:
        self._done_share = 0.0
        settings = settings_of(goal)
        settings.bounds_for(self.rig)
        return IdentificationRequest(self.bags(goal.bags), self.bags(goal.validation_bags),
                                     self.rig, settings)

    def feedback(self, progress: Progress, elapsed: float) -> IdentifyRing.Feedback:
        """One iteration of the swarm or of the refinement; no iteration while bags are read."""
        step = progress.search or SearchStep(0, 0, math.nan, (), 1.0)
        begin, end = SHARES.get(progress.task, (0.0, 1.0))
        self._done_share = max(self._done_share, begin + (end - begin) * progress.share)
        return IdentifyRing.Feedback(
            stage=progress.words, iteration=step.iteration, iterations=step.iterations,
            best_objective=step.best_objective, best_parameters=list(step.best_parameters),
            spread=step.spread, elapsed=elapsed, progress=min(self._done_share, 1.0))


def settings_of(goal: IdentifyRing.Goal) -> IdentificationSettings:
    """The settings of a goal; SaddleringError for one that cannot be used."""
    chosen: dict[str, Any] = {}
    for field, (setting, largest) in SWARM_FIELDS.items():
        value = getattr(goal, field)
        if not 0 <= value <= largest:
            raise NodeError(f'{field} is {value}: give a number above 0, at most '
                            f'{largest:g}, or 0 for the default')
        if value:
            chosen[setting] = value
    low, high = list(goal.lower_bounds), list(goal.upper_bounds)
    if (low or high) and not len(low) == len(high) == len(PARAMETER_NAMES):
        raise NodeError(f'bounds have {len(low)} and {len(high)} numbers: give six each, in the '
                        f'order {", ".join(PARAMETER_NAMES)}, or none')
    bounds = dict(zip(PARAMETER_NAMES, zip(low, high, strict=True), strict=False))
    return IdentificationSettings(
        method=goal.method or 'default', bounds=bounds, swarm=SwarmSettings(**chosen),
        logarithmic_stiffness=goal.logarithmic_stiffness,
        use_delta_y=True if goal.use_delta_y else None, seed=goal.seed)


main = executable(RingIdentificationNode, serve)

if __name__ == '__main__':
    main()
