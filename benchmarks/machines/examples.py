"""The machines of examples/any_simulator, as the other machines are described."""

import importlib.util
from pathlib import Path

from machines.machine import Draw, Machine
from saddlering_ros.discrepancy import Run

FOLDER = Path(__file__).resolve().parents[2] / 'examples' / 'any_simulator'
ALSO_HIDDEN = {
    'closed_loop': {'spring': {'rate': 30.0}},
    'mask': {'late_damping': {'size': 0.5}},
    'no_rest': {'drag': {'size': 0.1}},
    'several_outputs': {'overflow': {'height': 0.2}},
    'uneven_sampling': {'heater': {'power': 0.02}},
}
"""Sizes of the effects that the examples have in their catalogue and do not hide themselves."""


def machine(name: str) -> Machine:
    """One example; its seed draws drive and noise, its parameters stay.

    The drives of the examples rise with their seed and are made for the first dozen.
    """
    spec = importlib.util.spec_from_file_location(name, FOLDER / f'{name}.py')
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    first = next(iter(module.HIDDEN)).split('.')[0]
    own = {key.split('.')[1]: value for key, value in module.HIDDEN.items()}

    def record(draw: Draw) -> Run:
        number = 3 * (draw.seed % 4) + draw.number
        run: Run = module.record(f'run {draw.number}', number, dict(draw.hidden))
        return run

    hidden = {first: own, **ALSO_HIDDEN[name]}
    usual = {name: module.TRUE[name] for name in module.model.base}
    return Machine(name, 'examples/any_simulator', 'of this repository', module.model, hidden,
                   record, usual, constant=tuple(usual))
