"""Sessions of one dirty virtual ring: the ring keeps its dirt, noise is new in every session."""

from collections.abc import Sequence
import math

from benchmarks.rigs import as_read
from saddlering_ros.doubts.readings import run_of_record
from saddlering_ros.record.record import Record, TestMetadata
from saddlering_ros.rig import ContactParameters, default_rig, Rig, TONNE, TRUE_TO_SCALE
from saddlering_ros.virtual_rig import experiment
from saddlering_ros.virtual_rig.effects import EffectRequest, request
from saddlering_ros.virtual_rig.experiment import Instruments, PhysicalRig, record_test, TestPlan
from saddlering_ros.virtual_rig.integrator import Scatter

RIG = default_rig()
EPOCH, DAY, HALF_HOUR = 1_760_000_000, 86_400, 1_800
USUAL = Scatter(1e-6, 0.02)
TESTS = (('static', 50.0), ('dynamic', 50.0))


def dirt() -> list[EffectRequest]:
    """Small errors of a real rig, all at once."""
    sizes = {'load_gain': {'gain': 3e-3}, 'load_offset': {'offset': -150.0},
             'elevation_error': {'angle': 5e-4}, 'moment_arm': {'offset': -2e-3},
             'probe_height': {'height': 2e-3}, 'radial_friction': {'force': 350.0},
             'cylinder_friction': {'force': 300.0}}
    return [request(name, values) for name, values in sizes.items()]


def with_size(effects: Sequence[EffectRequest], name: str, size: float) -> list[EffectRequest]:
    """The same with an effect of another size."""
    others = [item for item in effects if item.effect.id != name]
    main = request(name).effect.parameters[0].name
    return [*others, request(name, {main: size})]


def session(
    day: int, effects: Sequence[EffectRequest], *, tests: Sequence[tuple[str, float]] = TESTS,
    contact: ContactParameters = TRUE_TO_SCALE, ring: str = 'SR-1', rollers: int = 7,
    step: float = 2.0 * TONNE, rig: Rig = RIG, scatter: Scatter = USUAL,
) -> list[Record]:
    """Records of a session on a day of the ring with rollers of this number and scatter.

    step [N]: from one held load to the next; rig: as it stands, whatever its file says.
    """
    records = []
    for number, (test, degrees) in enumerate(tests):
        physical = PhysicalRig(rig, contact, math.radians(degrees), tuple(effects),
                               scatter, rollers)
        schedule = (experiment.static_schedule(RIG, hold=2.5, step=step) if test == 'static'
                    else experiment.dynamic_schedule(RIG, duration=8.0))
        made = record_test(TestPlan(
            physical, schedule, 100 * day + number, Instruments(0.3e-6),
            25.0 if test == 'static' else 250.0, begin=EPOCH + DAY * day + HALF_HOUR * number))
        raw = as_read(made, RIG.probes, TestMetadata(test, degrees, rig=ring),
                      f'{test}_{degrees:g}_{day}')
        records.append(run_of_record(raw, raw.facts, RIG))
    return records
