"""Start the nodes of one rig.

    ros2 launch saddlering_ros rig.launch.py elevation:=50 replay:=false      on a rig
    ros2 launch saddlering_ros rig.launch.py bag:=PATH                        replay a bag
    ros2 launch saddlering_ros rig.launch.py namespace:=rig1 elevation:=50    one of several rigs

Without a bag the replay nodes are left out unless replay:=true, with which they wait for one.
Whatever publishes the topics of the rig drives the rest: a driver of the hardware, or
`ros2 bag play PATH --clock` with use_sim_time:=true.
"""

import math
from pathlib import Path

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument, ExecuteProcess, OpaqueFunction
from launch.substitutions import LaunchConfiguration, PathJoinSubstitution
from launch_ros.actions import LifecycleNode, Node
from launch_ros.substitutions import FindPackagePrefix, FindPackageShare

from saddlering_ros.record.topics import TOPICS
from saddlering_ros.rig import load_rig
from saddlering_ros.rig.description import rig_file_of_project
from saddlering_ros.rig.geometry import frames_of, RING_FRAME
from saddlering_ros.ros.launcher import PACKED, transport_environment
from saddlering_ros.ros.names import ACTION, ALARM, NODES, REPLAY, RING, TIME

PACKAGE = 'saddlering_ros'

ARGUMENTS = {
    'bag': ('', 'bag to replay; empty: none'),
    'elevation': ('', 'elevation of the load in degrees; empty: as the bag states'),
    'test': ('', 'kind of test for record:=, static or dynamic; needs elevation:= too'),
    'parameters': ('', 'contact parameters to simulate with; empty: true to scale'),
    'bag_root': ('', 'folder of the bags that goals may name; empty: that of the bag replayed, or '
                 'the shipped ones'),
    'parameters_root': ('', 'folder of the parameter files that goals may name; empty: bag_root'),
    'rate': ('1.0', 'speed of the replay'),
    'materiality': ('2.0', 'residual without an alarm, in percent of the range to full scale'),
    'false_alarm_hours': ('1000.0', 'hours of testing in which one false alarm is allowed'),
    'namespace': ('', 'namespace of the rig; empty: the root'),
    'hardware_id': ('', 'identity of the rig in /diagnostics; empty: by the namespace'),
    'record': ('', 'bag to record everything into; empty: record nothing'),
    'log_level': ('info', 'debug, info, warn, error or fatal'),
}
CHOICES = {
    'lockstep': ('false', ['true', 'false'],
                 'replay waits for the nodes; with rate:=0 it runs as fast as they follow'),
    'replay': ('', ['', 'true', 'false'], 'start the replay nodes; empty: with a bag'),
    'alarm': ('true', ['true', 'false'], 'start the alarm'),
    'servers': ('true', ['true', 'false'], 'start the action servers'),
    'respawn': ('false', ['true', 'false'], 'start a node again that has ended'),
    'autostart': ('true', ['true', 'false'],
                  'nodes configure and activate themselves; false: leave both to ros2 lifecycle'),
    'use_sim_time': ('', ['', 'true', 'false'], 'follow the clock; empty: when a bag is replayed'),
    'transforms': ('false', ['true', 'false'],
                   'publish the frames of ring, probes and displaced ring (needs tf2_ros)'),
    'analyzers': ('false', ['true', 'false'],
                  'group /diagnostics (needs package diagnostic_aggregator)'),
}
TOPIC_ARGUMENTS = {f'{topic.relative.rpartition("/")[2]}_topic': topic.relative
                   for topic in TOPICS.values()}
"""Name of the argument that renames a topic of the rig, and the topic."""


def generate_launch_description():
    """Return the arguments, and what starts the nodes from them."""
    rig = (str(rig_file_of_project() or '')
           or PathJoinSubstitution([FindPackageShare(PACKAGE), 'config', 'rig.yaml']))
    return LaunchDescription([
        DeclareLaunchArgument('rig', default_value=rig, description='rig description'),
        *(DeclareLaunchArgument(name, default_value=default, description=words)
          for name, (default, words) in ARGUMENTS.items()),
        *(DeclareLaunchArgument(name, default_value=default, choices=choices, description=words)
          for name, (default, choices, words) in CHOICES.items()),
        *(DeclareLaunchArgument(name, default_value=topic, description=f'name of topic {topic}')
          for name, topic in TOPIC_ARGUMENTS.items()),
        OpaqueFunction(function=start_nodes),
    ])


def start_nodes(context):
    """Return the nodes, each with what it needs of the arguments."""
    given = {name: LaunchConfiguration(name).perform(context)
             for name in ('rig', *ARGUMENTS, *CHOICES, *TOPIC_ARGUMENTS)}
    namespace = '/' + given['namespace'].strip('/') if given['namespace'].strip('/') else ''
    kinds = [RING, ALARM] if given['alarm'] == 'true' else [RING]
    if given['servers'] == 'true':
        kinds.append(ACTION)
    if given['replay'] == 'true' or (not given['replay'] and given['bag']):
        kinds += [REPLAY, TIME]
    common = {
        'namespace': namespace, 'output': 'screen', 'respawn': given['respawn'] == 'true',
        'arguments': ['--ros-args', '--log-level', given['log_level']],
        'remappings': remappings(given, namespace),
        'additional_env':
            transport_environment(PACKED) if given['lockstep'] == 'true' else {},
    }
    parameters = parameters_by_kind(given)
    nodes = []
    for node in (node for kind in kinds for node in NODES if node.kind == kind):
        own = [simulation(given)] if node.name == 'ring_simulator' else []
        own += [elevation(given)] if node.name == 'ring_displacement' else []
        own += frame_ids(given, namespace, node)
        own += [alarm(given)] if node.kind == ALARM else []
        make = Node if node.kind == ACTION else LifecycleNode
        nodes.append(make(
            package=PACKAGE, executable=node.name, name=node.name, **common,
            parameters=[as_path(given['rig']), *parameters[node.kind], *own]))
    return [*nodes, *recorder(given, namespace), *transforms(given, namespace),
            *aggregator(given)]


def parameters_by_kind(given):
    """Return the parameters of the nodes of each kind."""
    bag = as_path(given['bag'])
    every = {'hardware_id': given['hardware_id']}
    autostart = {'autostart': given['autostart'] == 'true'}
    replay = {'bag': bag, 'autostart': given['autostart'] == 'true' and bool(bag)}
    clock = {'rate': number('rate', given), 'lockstep': given['lockstep'] == 'true',
             **elevation(given)}
    if given['alarm'] == 'true':
        clock['participants'] = [node.name for node in NODES
                                 if node.kind in (REPLAY, RING, ALARM)]
    sim_time = {'use_sim_time': given['use_sim_time'] == 'true' or (
        not given['use_sim_time'] and bool(bag))}
    roots = {
        'bag_root': as_path(given['bag_root']) or (str(Path(bag).parent) if bag else ''),
        'parameters_root': as_path(given['parameters_root']),
    }
    return {ACTION: [every, roots], TIME: [every, replay, clock], REPLAY: [every, replay],
            RING: [every, autostart, sim_time], ALARM: [every, autostart, sim_time]}


def simulation(given):
    """Return the parameters of the simulator alone."""
    found = {'parameters_file': as_path(given['parameters']), **elevation(given)}
    if given['bag'] and not given['elevation']:
        found['bag'] = as_path(given['bag'])
    return found


def elevation(given):
    """Return the elevation as a parameter, if it is given."""
    return {'elevation_deg': number('elevation', given)} if given['elevation'] else {}


def alarm(given):
    """Return the parameters of the alarm alone."""
    return {name: number(name, given) for name in ('materiality', 'false_alarm_hours')}


def remappings(given, namespace):
    """Return the topics that have other names, and the clock of the namespace."""
    found = [(topic, given[name]) for name, topic in TOPIC_ARGUMENTS.items()
             if given[name] != topic]
    return found + [(f'/{topic}', f'{namespace}/{topic}') for topic in ('clock', 'tf')
                    if namespace]


def recorder(given, namespace):
    """Return the process that records, if one is wanted."""
    if not given['record']:
        return []
    program = PathJoinSubstitution([FindPackagePrefix(PACKAGE), 'lib', PACKAGE, 'saddlering'])
    return [ExecuteProcess(
        cmd=[program, 'record', as_path(given['record']), '--namespace', namespace or '/',
             '--rig', as_path(given['rig']), *test_arguments(given)],
        output='screen')]


def test_arguments(given):
    """Return the facts of the test for the recorder; the launch stops if one of two is missing."""
    if not given['test']:
        if given['elevation']:
            raise RuntimeError(
                'record:= with elevation:= needs test:=static or test:=dynamic too: commands '
                'refuse a bag that states only one of the two')
        return []
    number('elevation', given)
    return ['--test', given['test'], '--elevation', given['elevation']]


def frame_ids(given, namespace, node):
    """Return the names of the frames of a node below the prefix of the rig, if they are wanted."""
    if given['transforms'] != 'true' or node.kind not in (RING, ALARM):
        return []
    frame = f'{namespace}/{RING_FRAME}'.lstrip('/')
    found = [{'frame_id': frame}]
    return found + ([{'displaced_frame_id': f'{frame}_displaced'}]
                    if node.name == 'ring_displacement' else [])


def transforms(given, namespace):
    """Return a publisher for each frame of the rig, if they are wanted."""
    if given['transforms'] != 'true':
        return []
    elevation = math.radians(number('elevation', given)) if given['elevation'] else None
    return [Node(
        package='tf2_ros', executable='static_transform_publisher',
        name=f'frame_{frame.name}', namespace=namespace,
        arguments=transform_arguments(frame, namespace.lstrip('/')),
        remappings=[('/tf_static', f'{namespace}/tf_static')] if namespace else [])
        for frame in frames_of(load_rig(given['rig']), elevation)]


def transform_arguments(frame, prefix=''):
    """Return a frame as static_transform_publisher takes it, its names below the rig's prefix."""
    names = ('x', 'y', 'z', 'qx', 'qy', 'qz', 'qw')
    values = (*frame.translation, *frame.rotation)
    numbers = [text for name, value in zip(names, values, strict=True)
               for text in (f'--{name}', repr(value))]
    parent, child = (f'{prefix}/{name}' if prefix else name
                     for name in (frame.parent, frame.name))
    return [*numbers, '--frame-id', parent, '--child-frame-id', child]


def aggregator(given):
    """Return the node that groups /diagnostics, if it is wanted."""
    if given['analyzers'] != 'true':
        return []
    file = PathJoinSubstitution([FindPackageShare(PACKAGE), 'config', 'analyzers.yaml'])
    return [Node(package='diagnostic_aggregator', executable='aggregator_node', name='analyzers',
                 parameters=[file])]


def as_path(text):
    """Return the absolute path that `text` names, or '' for none."""
    return str(Path(text).expanduser().absolute()) if text else ''


def number(name, given):
    """Return an argument as a float; the launch stops at one that is none."""
    try:
        return float(given[name])
    except ValueError:
        raise RuntimeError(f'{name}:={given[name]}: give a number') from None
