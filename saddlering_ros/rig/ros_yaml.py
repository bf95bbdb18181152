"""ROS 2 parameter files: the `/**: ros__parameters:` shape as a nested dictionary, or RigError."""

from collections.abc import Mapping
from pathlib import Path
import re
from typing import Any

from saddlering_ros.errors import did_you_mean, refuse_unknown_keys, SaddleringError
from saddlering_ros.plain_yaml import read_strict_yaml

SECTIONS = ('rig', 'bounds', 'contact', 'effects', 'source')
"""What a rig file or a parameter file may hold; one file may be both."""

OF_EVERY_NODE = ('use_sim_time',)
"""Parameters of ROS itself that the same file may hold."""


class RigError(SaddleringError):
    """A rig or parameter file that cannot be used; one line: fault, place, remedy."""


def read_ros_parameters(path: Path) -> dict[str, Any]:
    """The parameters of the file's node entry, nested; dotted keys are unfolded.

    Raises RigError with one line when the file cannot be read or has another shape.
    """
    document = read_strict_yaml(path, RigError)
    if not isinstance(document, Mapping):
        raise RigError(f'{path}: is not a ROS 2 parameter file: '
                       'start it with "/**: ros__parameters:"')
    entries = {key: node for key, node in document.items()
               if isinstance(node, Mapping) and isinstance(node.get('ros__parameters'), Mapping)}
    if not entries:
        raise RigError(f'{path}: has no ros__parameters: start it with "/**: ros__parameters:"')
    others = [str(key) for key in document if key not in entries]
    if others:
        raise RigError(f'{path}: {others[0]} stands outside of ros__parameters: '
                       'move it below "/**: ros__parameters:"')
    if len(entries) > 1:
        raise RigError(f'{path}: has parameters for several nodes ('
                       f'{", ".join(map(str, entries))}): put them into one entry "/**"')
    (node,) = entries.values()
    beside = [str(key) for key in node if key != 'ros__parameters']
    if beside:
        raise RigError(f'{path}: {beside[0]} is beside ros__parameters: move it below')
    return unfold(node['ros__parameters'], str(path), RigError)


def check_sections(parameters: Mapping[str, Any], needed: str, hint: str, where: str) -> None:
    """RigError if the section `needed` is missing, or if a section is not in SECTIONS."""
    known = (*SECTIONS, *OF_EVERY_NODE)
    unknown = [key for key in parameters if key not in known]
    if needed not in parameters and not any(did_you_mean(key, known) for key in unknown):
        raise RigError(f'{where}: there is no {needed} section: {hint}')
    refuse_unknown_keys(parameters, known, '', where, RigError)


def unfold(
    parameters: Mapping[str, Any], where: str, error: type[SaddleringError],
) -> dict[str, Any]:
    """Dotted keys (`rig.preload`) made nested dictionaries; numbers written 1e8 made floats.

    Raises `error` where two entries contradict each other: a value and a section of one name, or
    one name in both notations.
    """
    result: dict[str, Any] = {}

    def put(place: dict[str, Any], entries: Mapping[str, Any], above: str) -> None:
        for key, value in entries.items():
            name, dot, below = str(key).partition('.')
            full = above + name
            if dot or isinstance(value, Mapping):
                inner = place.setdefault(name, {})
                if not isinstance(inner, dict):
                    raise error(f'{where}: {full} is given as a value and as a section: remove '
                                'one')
                put(inner, {below: value} if dot else value, f'{full}.')
                continue
            if name in place:
                kind = 'as a value and as a section' if isinstance(place[name], dict) else 'twice'
                raise error(f'{where}: {full} is given {kind}: remove one')
            place[name] = _number(value)

    put(result, parameters, '')
    return result


def _number(value: Any) -> Any:
    """YAML 1.1 reads `1e8` as text; ROS and this reader read it as a number."""
    if isinstance(value, list):
        return [_number(item) for item in value]
    try:
        return float(value) if isinstance(value, str) else value
    except ValueError:
        return value


def plain_exponents(line: str) -> str:
    """Exponents as ROS and YAML 1.1 read them: 4e-05 as 4.0e-05, 1.5e16 as 1.5e+16."""
    line = re.sub(r'(?<![\d.])(\d+)e([+-]?\d+)', r'\1.0e\2', line)
    return re.sub(r'(\d\.\d+)e(\d)', r'\1e+\2', line)
