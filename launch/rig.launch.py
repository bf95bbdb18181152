"""Start every node of the suite, on one rig description.

    ros2 launch saddlering_ros rig.launch.py elevation:=50      on a rig, or beside ros2 bag play
    ros2 launch saddlering_ros rig.launch.py bag:=PATH          replay a bag

Without a bag the three replay nodes wait unconfigured; whatever publishes the topics of the rig
drives the rest: a driver of the hardware, or `ros2 bag play PATH --clock` with use_sim_time:=true.
"""

from pathlib import Path

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument, OpaqueFunction
from launch.substitutions import LaunchConfiguration, PathJoinSubstitution
from launch_ros.actions import Node
from launch_ros.substitutions import FindPackageShare

from saddlering_ros.ros.registry import ACTION, CLOCK, NODES, REPLAY, RING

PACKAGE = 'saddlering_ros'


def generate_launch_description():
    """Return the arguments, and what starts the nodes from them."""
    rig = PathJoinSubstitution([FindPackageShare(PACKAGE), 'config', 'rig.yaml'])
    return LaunchDescription([
        DeclareLaunchArgument('bag', default_value='', description='bag to replay; empty: none'),
        DeclareLaunchArgument(
            'elevation', default_value='',
            description='elevation of the load in degrees; empty: as the bag says'),
        DeclareLaunchArgument('rig', default_value=rig, description='rig description'),
        DeclareLaunchArgument(
            'parameters', default_value='',
            description='contact parameters to simulate with; empty: true to scale'),
        DeclareLaunchArgument(
            'bag_root', default_value='',
            description='folder of the bags that goals may name; empty: that of the bag replayed, '
                        'or the shipped ones'),
        DeclareLaunchArgument(
            'parameters_root', default_value='',
            description='folder of the parameter files that goals may name; empty: bag_root'),
        DeclareLaunchArgument('rate', default_value='1.0', description='speed of the replay'),
        DeclareLaunchArgument(
            'lockstep', default_value='false', choices=['true', 'false'],
            description='replay waits for the nodes; with rate:=0 it runs as fast as they follow'),
        DeclareLaunchArgument(
            'use_sim_time', default_value='', choices=['', 'true', 'false'],
            description='follow /clock; empty: when a bag is replayed'),
        OpaqueFunction(function=start_nodes),
    ])


def start_nodes(context):
    """Return the nodes, each with what it needs of the arguments."""
    given = {name: LaunchConfiguration(name).perform(context) for name in (
        'bag', 'elevation', 'rig', 'parameters', 'bag_root', 'parameters_root', 'rate', 'lockstep',
        'use_sim_time')}
    bag, rig, contact = (as_path(given[name]) for name in ('bag', 'rig', 'parameters'))
    sim_time = {'use_sim_time': given['use_sim_time'] == 'true' or (
        not given['use_sim_time'] and bool(bag))}

    replay = {'bag': bag, 'autostart': bool(bag)}
    clock = {'rate': number('rate', given), 'lockstep': given['lockstep'] == 'true'}
    simulation = {'parameters_file': contact}
    if given['elevation']:
        simulation['elevation_deg'] = number('elevation', given)
    elif bag:
        simulation['bag'] = bag

    roots = {
        'bag_root': as_path(given['bag_root']) or (str(Path(bag).parent) if bag else ''),
        'parameters_root': as_path(given['parameters_root']),
    }

    of_kind = {ACTION: [roots], CLOCK: [replay, clock], REPLAY: [replay], RING: [sim_time]}
    of_node = {'ring_simulator': [simulation]}
    return [
        Node(package=PACKAGE, executable=node.name, name=node.name, output='screen',
             parameters=[rig, *of_kind[node.kind], *of_node.get(node.name, [])])
        for kind in (RING, ACTION, REPLAY, CLOCK) for node in NODES if node.kind == kind
    ]


def as_path(text):
    """Return the absolute path that `text` names, or '' for none."""
    return str(Path(text).expanduser().absolute()) if text else ''


def number(name, given):
    """Return an argument as a float; the launch stops at one that is none."""
    try:
        return float(given[name])
    except ValueError:
        raise RuntimeError(f'{name}:={given[name]}: give a number') from None
