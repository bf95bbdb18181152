"""Node ring_diagnosis: the action /diagnose_ring, which names the cause of a misfit or change."""

import json
from typing import Any

from saddlering_interfaces.action import DiagnoseRing
from saddlering_ros.jobs.action_server import ActionNode, serve
from saddlering_ros.jobs.requests import Answer, DiagnosisRequest
from saddlering_ros.progress import Progress
from saddlering_ros.ros.messages import fill_diagnosis
from saddlering_ros.ros.names import DIAGNOSE, NodeError
from saddlering_ros.ros.parameters import below
from saddlering_ros.ros.streaming_node import executable


class RingDiagnosisNode(ActionNode):
    """Serves /diagnose_ring."""

    NODE = 'ring_diagnosis'
    ACTION = DiagnoseRing
    NAME = DIAGNOSE

    def request(self, goal: DiagnoseRing.Goal) -> DiagnosisRequest:
        if goal.before and (goal.hold_out or goal.parameters_file):
            raise NodeError('the goal names bags of before: a comparison takes neither hold_out '
                            'nor parameters_file, leave both empty')
        return DiagnosisRequest(
            self.bags(goal.bags), self.bags(goal.before), self.bags(goal.hold_out), self.rig,
            str(below(self.parameters_root, goal.parameters_file, 'parameter file'))
            if goal.parameters_file else '', int(goal.seed))

    def feedback(self, progress: Progress, elapsed: float) -> DiagnoseRing.Feedback:
        """The share that is done; 0 while bags are read."""
        share = progress.share if progress.task in ('diagnose', 'compare') else 0.0
        return DiagnoseRing.Feedback(stage=progress.words, progress=share, elapsed=elapsed)

    def fill(self, result: Any, answer: Answer) -> None:
        super().fill(result, answer)
        fill_diagnosis(result, json.loads(result.verdict_json))


main = executable(RingDiagnosisNode, serve)

if __name__ == '__main__':
    main()
