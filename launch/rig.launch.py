"""Start every node of the suite, on one rig description.

    ros2 launch saddlering_ros rig.launch.py                       on a rig, or beside ros2 bag play
    ros2 launch saddlering_ros rig.launch.py bag:=PATH             replay a bag

Without a bag the replay nodes wait, and whatever publishes the topics of the rig drives the rest:
a driver of the hardware, or `ros2 bag play PATH --clock` with use_sim_time:=true.
"""

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument
from launch.substitutions import LaunchConfiguration, PathJoinSubstitution, PythonExpression
from launch_ros.actions import Node
from launch_ros.parameter_descriptions import ParameterValue
from launch_ros.substitutions import FindPackageShare

PACKAGE = 'saddlering_ros'

REPLAY_NODES = ('replay_clock', 'hydraulic_load', 'eddy_current')
RIG_NODES = ('ring_displacement', 'ring_simulator', 'ring_residual')
SERVERS = ('ring_identification', 'ring_diagnosis')


def generate_launch_description():
    """Return the nodes, and the arguments that set them up."""
    bag = LaunchConfiguration('bag')
    rig = LaunchConfiguration('rig')
    sim_time = {'use_sim_time': ParameterValue(LaunchConfiguration('use_sim_time'), value_type=bool)}
    facts = {
        'bag': ParameterValue(bag, value_type=str),
        'elevation_deg': ParameterValue(LaunchConfiguration('elevation'), value_type=float),
        'parameters_file': ParameterValue(LaunchConfiguration('parameters'), value_type=str),
    }

    def node(executable, *parameters):
        return Node(package=PACKAGE, executable=executable, name=executable, output='screen',
                    parameters=[rig, *parameters])

    return LaunchDescription([
        DeclareLaunchArgument('bag', default_value='', description='bag to replay; empty: none'),
        DeclareLaunchArgument(
            'elevation', default_value='nan',
            description='elevation of the test in degrees; nan: as the bag says'),
        DeclareLaunchArgument(
            'rig', description='rig description',
            default_value=PathJoinSubstitution([FindPackageShare(PACKAGE), 'config', 'rig.yaml'])),
        DeclareLaunchArgument(
            'parameters', default_value='',
            description='contact parameters to simulate with; empty: true to scale'),
        DeclareLaunchArgument(
            'use_sim_time', description='follow /clock',
            default_value=PythonExpression(["'", bag, "' != ''"])),
        *[node(name, facts) for name in REPLAY_NODES],
        *[node(name, facts, sim_time) for name in RIG_NODES],
        *[node(name) for name in SERVERS],
    ])
