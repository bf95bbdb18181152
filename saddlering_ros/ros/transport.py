"""Settings of the middleware: discovery on this machine; UDP, many messages to a packet."""

from __future__ import annotations

import os

from saddlering_ros.files import share_directory

DISCOVERY_VARIABLES = ('ROS_AUTOMATIC_DISCOVERY_RANGE', 'ROS_LOCALHOST_ONLY')
PROFILE_VARIABLES = ('FASTRTPS_DEFAULT_PROFILES_FILE', 'FASTDDS_DEFAULT_PROFILES_FILE')
PUBLICATION_VARIABLE = 'RMW_FASTRTPS_PUBLICATION_MODE'


def transport_environment() -> dict[str, str]:
    """Environment that a process needs, before rclpy.init, to use config/fastdds.xml.

    Empty if the user has chosen a file. Other middlewares than Fast DDS ignore it.
    Published synchronously, a message is on its way before `publish` returns; the profile has no
    say in that.
    """
    if any(os.environ.get(name) for name in PROFILE_VARIABLES):
        return {}
    return {PROFILE_VARIABLES[0]: str(share_directory() / 'config' / 'fastdds.xml'),
            PUBLICATION_VARIABLE: os.environ.get(PUBLICATION_VARIABLE) or 'SYNCHRONOUS'}


def packed_publication() -> dict[str, str]:
    """Environment of nodes in lockstep, where throughput counts and latency does not.

    Published asynchronously, messages that wait go out together in one packet. The thread that
    sends them takes part of the processor from the publishing one meanwhile, and delays a stream
    in real time.
    """
    if any(os.environ.get(name) for name in PROFILE_VARIABLES):
        return {}
    return {PUBLICATION_VARIABLE: os.environ.get(PUBLICATION_VARIABLE) or 'ASYNCHRONOUS'}


def local_discovery() -> dict[str, str]:
    """Environment that keeps discovery on this machine, unless the user has chosen a range.

    ROS 2's own default is the subnet: everybody there could see the topics, call services, send
    goals and publish loads.
    """
    if any(os.environ.get(name) for name in DISCOVERY_VARIABLES):
        return {}
    return {DISCOVERY_VARIABLES[0]: 'LOCALHOST'}


def prepare_transport() -> None:
    """Set both for this process."""
    os.environ.update({**transport_environment(), **local_discovery()})
