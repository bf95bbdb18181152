"""Compile the kernels once and store them: python -m saddlering_ros.ring.warm.

Set-up runs this module, so that no node or command compiles at its start.
"""

from dataclasses import replace
import time

import numpy as np

from saddlering_ros.effects.extension import NO_EXTENSION
from saddlering_ros.rig import default_rig, ParameterSet, TRUE_TO_SCALE
from saddlering_ros.ring import sensitivity
from saddlering_ros.ring.kernels.layout import kernel
from saddlering_ros.ring.simulator import dynamic_batch, simulate, static_response


def warm() -> float:
    """Call every kernel of the package once; the duration in seconds."""
    rig, elevation = default_rig(), np.deg2rad(50.0)
    began = time.perf_counter()
    seconds = np.linspace(0.0, 0.59, 60)
    load = np.full(seconds.size, rig.preload)
    contact = TRUE_TO_SCALE.to_array()
    still = static_response(rig, contact, elevation, load[:2])
    sensitivity.static_sensitivities(rig, contact, elevation, still)
    dynamic_batch(rig, contact[None], elevation, seconds, load)
    sensitivity.FollowedMotion(rig, contact, elevation, seconds, load).sensitivities()
    plain, creeping = (contact, NO_EXTENSION), (contact, replace(NO_EXTENSION, creep_axial=0.1))
    sensitivity.Neighbourhoods(rig, [(plain, [plain, creeping])]).along(elevation, seconds, load)
    sensitivity.load_sensitivity(rig, TRUE_TO_SCALE, elevation, seconds, load, 6)
    simulate(rig, ParameterSet(TRUE_TO_SCALE), elevation, seconds, load)
    return time.perf_counter() - began


def main() -> None:
    """Compile, and print the duration."""
    seconds = warm()
    kept = f'kept in {kernel.folder}' if kernel.folder else 'not kept: set NUMBA_CACHE_DIR'
    print(f'ring kernels ready in {seconds:.1f} s ({kept})')


if __name__ == '__main__':
    main()
