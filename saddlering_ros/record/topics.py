"""The registry of the rig's topics: reader, aligner, decoder, nodes, recorder and bag read it.

A new topic of the rig is one entry here. A message type that no entry has used yet is one more
entry of `LAYOUTS` in bags/wire.py.
"""

from dataclasses import dataclass

WRENCH_TYPE = 'geometry_msgs/msg/WrenchStamped'
RANGE_TYPE = 'sensor_msgs/msg/Range'
VECTOR_TYPE = 'geometry_msgs/msg/Vector3Stamped'


@dataclass(frozen=True)
class RigTopic:
    """One topic of the rig."""

    name: str  # absolute, as a bag holds it
    type: str  # of its messages
    field: str  # of the reading in the message
    unit: str  # of the reading
    frame_id: str
    words: str
    replayed_by: str  # the node that replays it
    low: str = ''  # field of the lower end of the sensor's range; '' for none
    high: str = ''  # of the upper end
    required: bool = True  # whether a bag must hold it

    @property
    def relative(self) -> str:
        """The name that nodes use, so that a namespace goes before it."""
        return self.name.removeprefix('/')

    @property
    def fields(self) -> tuple[str, ...]:
        """The fields that are read: the reading, and the ends of its range where there are."""
        return (self.field, self.low, self.high) if self.low else (self.field,)


LOAD = RigTopic(
    '/rig/hydraulic_load', WRENCH_TYPE, 'wrench.force.x', 'N', 'hydraulic_cylinder',
    'load of the hydraulic cylinder: wrench.force.x [N]', 'hydraulic_load')
PROBES = tuple(RigTopic(
    f'/rig/eddy_current_{number}', RANGE_TYPE, 'range', 'm', f'eddy_current_{number}',
    f'gap [m] of eddy-current probe {number}', 'eddy_current', 'min_range', 'max_range')
    for number in (1, 2, 3, 4))
ELEVATION = RigTopic(
    '/rig/elevation', VECTOR_TYPE, 'vector.x', 'rad', 'inclinometer',
    'elevation of the barrel, where a rig measures it: vector.x [rad]', 'hydraulic_load',
    required=False)

TOPICS: dict[str, RigTopic] = {topic.name: topic for topic in (LOAD, *PROBES, ELEVATION)}
"""Every topic of a rig by its name."""

LOAD_TOPIC = LOAD.name
PROBE_TOPICS = tuple(topic.name for topic in PROBES)
RIG_TOPICS = (LOAD_TOPIC, *PROBE_TOPICS)
"""The topics that every test has."""
