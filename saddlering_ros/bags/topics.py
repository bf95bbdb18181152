"""The rig's raw topics and their message types."""

from __future__ import annotations

LOAD_TOPIC = '/rig/hydraulic_load'
PROBE_TOPICS = tuple(f'/rig/eddy_current_{number}' for number in (1, 2, 3, 4))
RIG_TOPICS = (LOAD_TOPIC, *PROBE_TOPICS)

WRENCH_TYPE = 'geometry_msgs/msg/WrenchStamped'
RANGE_TYPE = 'sensor_msgs/msg/Range'

TYPE_OF_TOPIC = {LOAD_TOPIC: WRENCH_TYPE, **dict.fromkeys(PROBE_TOPICS, RANGE_TYPE)}

FRAME_OF_TOPIC = {
    LOAD_TOPIC: 'hydraulic_cylinder',
    **{topic: topic.rpartition('/')[2] for topic in PROBE_TOPICS},
}
