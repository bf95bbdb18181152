"""Damping D (1 - s + s h), with h = (p/r)^m (1 + (r L)^m) / (1 + (p L)^m), in place of D alone."""

from collections.abc import Mapping

from saddlering_ros.effects.base import EffectParameter, RingEffect
from saddlering_ros.rig import Rig


class DampingLaw(RingEffect):
    title = 'Damping grows with penetration'
    words = ('The damping of a roller grows with its penetration, and the model has one constant '
             'D. In a dynamic run the lag behind the load grows with the load and not with the '
             'rate alone. A static run shows nothing. Damping may stop growing after the film is '
             'squeezed out; with a high power, damping then begins at one penetration.')
    settled_by = ('A second loading rate (x4): the lag scales with rate at each load, and its '
                  'shape over load stays.')
    outcomes = {'second_rate': 'a lag that keeps its shape over load and scales with the rate'}
    stage = 'ring'
    form = 0.1  # the power of penetration and the saturation may differ between the rows
    parameters = (
        EffectParameter(
            'share', '1', 0.0, 1.0, 0.5, 0.5,
            'share of the damping that grows; h = 1 at r = 50 µm', amplitude=True, one_sided=True,
            whole=1.0, adds_to='damping_penetration_share'),
        # Tsuji et al. 1992: 1/4; Kuwabara and Kono 1987: 1/2; Hunt and Crossley 1975: n
        EffectParameter('exponent', '1', 0.2, 8.0, 1.0, 10.0 / 9.0,
                        'm, by which damping grows; left out in a file: n of each row',
                        one_sided=True, logarithmic=True,
                        adds_to='damping_penetration_exponent'),
        EffectParameter('levelling', '1/m', 0.0, 2e5, 2e4, 0.0,
                        'L, one over the penetration beyond which damping is constant; 0: no '
                        'limit', one_sided=True, adds_to='damping_penetration_saturation'))
    dynamic_only = True
    starts = ({'exponent': 0.25}, {'exponent': 6.0, 'levelling': 5e4},
              {'exponent': 6.0, 'levelling': 1.2e5})

    def complete(self, values: Mapping[str, float], rig: Rig | None = None) -> dict[str, float]:
        """An exponent left out stays out: it is n of each row, as in files that have none."""
        complete = super().complete(values, rig)
        if 'exponent' not in values:
            del complete['exponent']
        return complete
