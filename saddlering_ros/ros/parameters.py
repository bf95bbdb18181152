"""Node parameters declared once: default, range and words, for ROS, the checks and the docs."""

from collections.abc import Callable, Iterator, Mapping, Sequence
import contextlib
from dataclasses import asdict, dataclass, replace
from itertools import pairwise
import math
import os
from pathlib import Path
import re
from typing import Any

from rcl_interfaces import msg
from rclpy.node import Node
from rclpy.parameter import Parameter as RosParameter
from rclpy.utilities import remove_ros_args
import yaml

from saddlering_ros.errors import did_you_mean, plain_number, SaddleringError
from saddlering_ros.plain_yaml import read_strict_yaml
from saddlering_ros.rig import default_rig, load_rig, PARAMETER_NAMES, Rig, short_digest
from saddlering_ros.rig.description import rig_from_parameters
from saddlering_ros.rig.drawing import dotted, ENTRIES, entry_values
from saddlering_ros.rig.instruments import instruments_from
from saddlering_ros.rig.parameter_file import SOURCE_KEYS, unfold
from saddlering_ros.ros.names import NodeError


@dataclass(frozen=True)
class NodeParameter:
    """One parameter of a node.

    low, high: range of a number, both included; choices: allowed texts; changeable: may be
    set while the node runs (else it is read only), while_inactive: only while a lifecycle node is
    not active; nan_allowed: NaN stands for `not given`.
    """

    name: str
    default: bool | float | str | list[str]
    words: str
    low: float = -math.inf
    high: float = math.inf
    choices: tuple[str, ...] = ()
    changeable: bool = False
    nan_allowed: bool = False
    while_inactive: bool = False

    def descriptor(self) -> msg.ParameterDescriptor:
        """Text of `ros2 param describe`; `refusal` judges the type, and says what to give."""
        descriptor = msg.ParameterDescriptor(
            name=self.name, description=self.words, dynamic_typing=True,
            read_only=not (self.changeable or self.while_inactive))
        if self.choices:
            descriptor.additional_constraints = f'one of: {", ".join(self.choices)}'
        bounded = math.isfinite(self.low) and math.isfinite(self.high) and not self.nan_allowed
        if isinstance(self.default, float) and bounded:
            descriptor.floating_point_range = [
                msg.FloatingPointRange(from_value=self.low, to_value=self.high)]
        return descriptor

    def refusal(self, value: Any) -> str:
        """Why `value` cannot be taken, in one line; empty if it can."""
        if type(value) is not type(self.default):
            return f'{self.name} is {value!r}: give {_KINDS[type(self.default)]}'
        if self.choices and value not in self.choices:
            return f'{self.name} is {value!r}: give one of {", ".join(self.choices)}'
        if (self.name.endswith('frame_id') and value != self.default
                and not re.fullmatch(r'[^/\s].*', str(value))):
            return f'{self.name} is {value!r}: give the name of a frame, without a / before it'
        if not isinstance(value, float) or (self.nan_allowed and math.isnan(value)):
            return ''
        if not math.isfinite(value):
            return f'{self.name} is {value}: give a finite number'
        if not self.low <= value <= self.high:
            return f'{self.name} is {value:g}: give a number from {self.low:g} to {self.high:g}'
        return ''

    def as_declared(self, given: RosParameter) -> RosParameter:
        """`given` as a float, if it is to be one: `ros2 param set` sends 50 as a whole number.

        It sends 1e-6 as the text that YAML 1.1 makes of it.
        """
        value = given.value
        if isinstance(self.default, float) and type(value) in (int, str):
            with contextlib.suppress(ValueError):
                return RosParameter(given.name, value=plain_number(str(value)))
        if value is None and isinstance(self.default, list):  # rclpy has no empty list
            return RosParameter(given.name, value=[''])
        return given


HARDWARE_ID = NodeParameter(
    'hardware_id', '', 'identity of the rig in /diagnostics; none: saddlering and the namespace')

TRUST_RIG = NodeParameter(
    'trust_rig', False, 'accept a bag or parameters that state another rig than the node has')


def refuse_other_rig(node: Node, refuse: Callable[[Any, Rig], None], stated: Any,
                     rig: Rig) -> None:
    """NodeError if `refuse` finds that another rig than the node's is stated.

    A node with trust_rig does not look. The remedy names parameters, not arguments of the API.
    """
    if node.get_parameter(TRUST_RIG.name).value:
        return
    try:
        refuse(stated, rig)
    except SaddleringError as problem:
        words = str(problem).replace('rig=FILE', '--params-file FILE')
        raise NodeError(words.replace('trust_rig=True', '-p trust_rig:=true')) from problem


def declare(node: Node, parameters: Sequence[NodeParameter]) -> dict[str, Any]:
    """Declare `parameters`; their values by name, texts stripped, which follow later changes."""
    overrides: dict[str, RosParameter] = node._parameter_overrides
    by_name, settings = {parameter.name: parameter for parameter in parameters}, {}
    for name, one in by_name.items():
        if name in overrides:
            given = overrides[name] = one.as_declared(overrides[name])
            if reason := one.refusal(given.value):
                raise NodeError(f'{node.get_name()}: parameter {reason}')
        settings[name] = _stripped(
            node.declare_parameter(name, one.default, one.descriptor()).value)

    def as_declared(changes: list[RosParameter]) -> list[RosParameter]:
        return [by_name[change.name].as_declared(change) if change.name in by_name else change
                for change in changes]

    def judge(changes: list[RosParameter]) -> msg.SetParametersResult:
        for change in changes:
            parameter = by_name.get(change.name)
            if parameter is None:
                continue
            reason = parameter.refusal(change.value)
            if parameter.while_inactive and getattr(node, 'active', False):
                reason = (f'{parameter.name} can change only while the node is inactive: ros2 '
                          f'lifecycle set {node.get_fully_qualified_name()} deactivate first')
            if reason:
                kept = node.get_parameter(change.name).type_  # rclpy has described the new type
                node.describe_parameter(change.name).type = kept.value
                return msg.SetParametersResult(successful=False, reason=reason)
        return msg.SetParametersResult(successful=True)

    def keep(changes: list[RosParameter]) -> None:
        settings.update({change.name: _stripped(change.value) for change in changes
                         if change.name in by_name})

    node.add_pre_set_parameters_callback(as_declared)
    node.add_on_set_parameters_callback(judge)
    node.add_post_set_parameters_callback(keep)
    return settings


def _stripped(value: Any) -> Any:
    return value.strip() if isinstance(value, str) else value


_KINDS = {bool: 'true or false', float: 'a number', str: 'a text', list: 'a list of texts'}


def declare_rig(node: Node) -> Rig:
    """The rig from the node's parameters `rig.*` and `bounds.*`, as config/rig.yaml sets them.

    Without any of them it is that of the project, or the shipped one. A part of a rig is refused,
    as commands refuse it: the rest would be that of another rig. RigError for a bad one.
    """
    nested = given_sections(node, ('rig', 'bounds'))
    is_given = 'rig' in nested
    project = default_rig() if is_given else load_rig()
    defaults = {name: default for name, default in dotted(
        project, entry_values(project)).items()
                if not node.has_parameter(name)}
    for name, default in defaults.items():
        node.declare_parameter(name, default, _descriptor_of(name))
    where = f'parameters of {node.get_name()}'
    if not is_given:
        nested = unfold(nested | defaults, where, NodeError)
    rig = rig_from_parameters(nested, where)
    if not is_given:
        rig = replace(rig, instruments=project.instruments, wear_limits=project.wear_limits)
    node.get_logger().info(f'rig {short_digest(rig.digest)}: ' + (
        'that of its parameters' if is_given else
        f'{project.source or "the shipped one"}, because no parameter rig.* is given'))
    return rig


def rig_words(name: str) -> str:
    """Meaning of a parameter of the rig; '' of what needs a text in the rig file alone."""
    section, _, key = name.partition('.')
    if section == 'bounds':
        return f'[low, high] of {key} in a search'
    return dict(ENTRIES).get(key, '') if section == 'rig' else ''


def _descriptor_of(name: str) -> msg.ParameterDescriptor:
    return msg.ParameterDescriptor(
        name=name, description=rig_words(name), read_only=True, dynamic_typing=True)


def given_sections(node: Node, sections: Sequence[str]) -> dict[str, Any]:
    """Start values under `sections`, nested; only given ones are declared (read only)."""
    overrides: dict[str, RosParameter] = node._parameter_overrides
    given = {name: node.declare_parameter(name, overrides[name].value, _descriptor_of(name)).value
             for name in sorted(overrides) if name.partition('.')[0] in sections}
    return unfold({name: value if isinstance(value, (int, float, str)) else list(value)
                   for name, value in given.items()}, node.get_name(), NodeError)


def refuse_undeclared(node: Node) -> None:
    """NodeError if the node was started with an unknown parameter.

    One file may serve every node, so the sections of rig files and parameter files are accepted
    by every node; their entries are checked all the same.
    """
    overrides: dict[str, RosParameter] = node._parameter_overrides
    sections = {'contact': PARAMETER_NAMES, 'source': SOURCE_KEYS}
    declared = [*node._parameters,
                *(f'{section}.{key}' for section, keys in sections.items() for key in keys)]
    for name in sorted(overrides):
        if name in declared or name.startswith('effects.'):
            continue
        if name.startswith('qos_overrides.'):
            raise NodeError(f'{node.get_name()}: parameter {name} has no effect: the parameter '
                            'input_reliability sets the QoS of inputs, and outputs are reliable')
        remedy = did_you_mean(name, declared) or (
            ': remove it, or move it below the name of its node')
        raise NodeError(f'{node.get_name()}: parameter {name} is unknown{remedy}')


def strict_arguments(arguments: Sequence[str]) -> list[str]:
    """The words after a program's name, read strictly for rclpy; NodeError for a bad one.

    rclpy leaves out words that are none of its own. Of a parameter file it lets the last of two
    equal keys win, reads 0110 as 72, and never returns from a pipe.
    """
    words = [_as_ros_reads(word) if option == '--params-file' else word
             for option, word in pairwise(['', *arguments])]
    for word in remove_ros_args(['', *words])[1:]:
        raise NodeError(f'{word} is not read: give --ros-args -p NAME:=VALUE')
    return words


def unaddressed(arguments: Sequence[str], node: Node) -> list[str]:
    """A warning on each parameter file of a command line that has no section for a node.

    ROS takes nothing of such a file, and says nothing.
    """
    warnings = []
    for file in [word for option, word in pairwise(arguments) if option == '--params-file']:
        name = node.get_fully_qualified_name()
        sections = sorted(_sections(read_strict_yaml(file, NodeError)))
        forms = [re.escape(one).replace(r'/\*\*', '(/[^/]+)*').replace(r'\*', '[^/]+')
                 for one in sections]
        if sections and not any(re.fullmatch(form, name) for form in forms):
            warnings.append(f'nothing of {file} is used: it has sections for '
                            f'{", ".join(sections)} and none for {name}: name this node or /**')
    return warnings


def _sections(document: Any, name: str = '') -> Iterator[str]:
    """Full names of nodes, with wildcards, that have a section in a parameter file."""
    for key, section in document.items() if isinstance(document, Mapping) else ():
        if key == 'ros__parameters':
            yield name
        else:
            yield from _sections(section, f'{name}/{str(key).strip("/")}')


def _with_equal_numbers(section: Any) -> bool:
    """Make the numbers of a list floats in each list that has floats; whether there was one."""
    is_changed = False
    for name, value in section.items() if isinstance(section, dict) else ():
        if isinstance(value, list) and {type(one) for one in value} == {int, float}:
            section[name], is_changed = [float(one) for one in value], True
        is_changed |= _with_equal_numbers(value)
    return is_changed


def _as_ros_reads(file: str) -> str:
    """A parameter file, or a copy in memory of what commands read in it and ROS does not.

    ROS has no lists of sections and none like [1, 1.5]; a node does not know the file's folder.
    """
    document = read_strict_yaml(file, NodeError)
    is_copy = _with_equal_numbers(document)
    for entry in document.values() if isinstance(document, Mapping) else ():
        given = entry.get('ros__parameters') if isinstance(entry, Mapping) else None
        if not isinstance(given, dict):
            continue
        rig = unfold(given, file, NodeError).get('rig')
        if not isinstance(rig, dict) or 'certificate' not in str(rig):
            continue
        stated = asdict(instruments_from(rig.pop('instruments', {}), file))
        for name in [name for name in given if name.partition('.')[0] == 'rig']:
            del given[name]
        given['rig'] = rig | {'instruments': {
            name: list(value) if isinstance(value, tuple) else value
            for name, value in stated.items() if value is not None}}
        is_copy = True
    if not is_copy:
        return file
    place = os.memfd_create('parameters')
    os.write(place, yaml.safe_dump(document).encode())
    return f'/proc/self/fd/{place}'


def root_folder(node: Node, parameter: str, default: Path) -> Path:
    """The folder that a parameter names, or `default`; NodeError if it is not there."""
    given = node.get_parameter(parameter).value.strip()
    root = Path(given).expanduser() if given else default
    if given and not root.is_dir():
        raise NodeError(f'{node.get_name()}: parameter {parameter} is {given}: '
                        'give a folder that exists')
    return root.resolve()


MAX_SHOWN = 200
"""Characters of a name that an error repeats."""


def below(root: Path, name: str, what: str) -> Path:
    """The file or folder `name` (relative to `root`, or absolute), which must lie below `root`.

    Links and `..` are resolved first. NodeError with one line if it does not, or is not there.
    """
    path = Path(name)
    try:
        real = (path if path.is_absolute() else root / path).resolve()
        is_there = real.exists()
    except (OSError, RuntimeError, ValueError) as problem:
        raise NodeError(
            f'{what} {name[:MAX_SHOWN]!r}: cannot be resolved: give a path below {root}'
        ) from problem
    if not name or not real.is_relative_to(root):
        parameter = 'bag_root' if what == 'bag' else 'parameters_root'
        raise NodeError(f'{what} {name!r} is not below {root}: put it there, or set the '
                        f"node's parameter {parameter}")
    if not is_there:
        raise NodeError(f'{what} {name!r} is not in {root}: check the name')
    return real


def bag_below(root: Path, name: str) -> Path:
    """A bag below `root` none of whose files is a link to somewhere else."""
    path = below(root, name, 'bag')
    inside = sorted(path.iterdir()) if path.is_dir() else [path]
    for file in inside:
        if not file.resolve().is_relative_to(root):
            raise NodeError(f'bag {name!r} holds {file.name}, a link to outside {root}: '
                            'copy the file there')
    return path
