"""Comparison of the message definitions in a bag with those by which its bytes are read."""

from __future__ import annotations

import re

from saddlering_ros.bags.layouts import definition_lines
from saddlering_ros.bags.mcap_file import McapChannel
from saddlering_ros.record.topics import RigTopic

_FIELD = re.compile(r'^\s*([A-Za-z][\w/]*(?:\[[^\]]*\])?)\s+([A-Za-z]\w*)\s*(?![\w=\s])', re.M)


def other_fields(channel: McapChannel, topic: RigTopic) -> str:
    """Reason why messages of `channel`, by their definition, cannot be read as `topic`, or ''.

    Only definitions of encoding ros2msg that name any field are judged. The part after the
    last field that is read may differ between releases of ROS.
    """
    if channel.schema_encoding != 'ros2msg':
        return ''
    expected = definition_lines(topic.type, topic.field)
    own = channel.definition.decode('utf-8', 'replace').partition('=====')[0]
    fields = [' '.join((found[1].rpartition('/')[2], found[2]))
              for line in own.splitlines() if (found := _FIELD.match(line))]
    if not fields or tuple(fields[:len(expected)]) == expected:
        return ''
    pairs = zip(expected, [*fields, *['nothing'] * len(expected)], strict=False)
    wanted, there = next(pair for pair in pairs if pair[0] != pair[1])
    return f'its definition of {channel.type} has {there!r} where {wanted!r} should be'
