"""Claims about the layouts for PlotJuggler and Foxglove: their format, fields that exist."""

import json
from xml.etree import ElementTree

from geometry_msgs.msg import WrenchStamped
import pytest
from sensor_msgs.msg import Range

from saddlering_interfaces.msg import RingDisplacement, RingParameters
from saddlering_ros.files import share_directory
from saddlering_ros.record.topics import LOAD_TOPIC, PROBE_TOPICS

CONFIG = share_directory() / 'config'
TYPES = {LOAD_TOPIC: WrenchStamped, **dict.fromkeys(PROBE_TOPICS, Range),
         **dict.fromkeys(('/ring/displacement', '/ring/simulated_displacement', '/ring/residual'),
                         RingDisplacement), '/ring/parameters': RingParameters}


def is_number(topic, fields):
    value = TYPES[topic]()
    for name in fields:
        value = getattr(value, name)
    return isinstance(value, float)


def split_name(name):
    """'/ring/residual/gamma' as PlotJuggler names it: topic and fields."""
    topic = next(topic for topic in TYPES if name.startswith(f'{topic}/'))
    return topic, name[len(topic) + 1:].split('/')


@pytest.fixture(scope='module')
def plotjuggler():
    return ElementTree.parse(CONFIG / 'plotjuggler.xml').getroot()


def test_plotjuggler_finds_its_elements_where_it_looks_for_them(plotjuggler):
    assert plotjuggler.tag == 'root'
    tabs = plotjuggler.findall('tabbed_widget[@name="Main Window"]/Tab')
    assert [tab.get('tab_name') for tab in tabs] == ['Load and displacement', 'Over time', 'Raw']
    for tab in tabs:
        assert len(tab.findall('Container')) == int(tab.get('containers'))
    for splitter in plotjuggler.iter('DockSplitter'):
        sizes = [float(size) for size in splitter.get('sizes').split(';')]
        assert splitter.get('orientation') in '-|'
        assert len(splitter) == len(sizes) == int(splitter.get('count'))
    for area in plotjuggler.iter('DockArea'):
        assert [child.tag for child in area] == ['plot']


def test_plotjuggler_curves_are_fields_of_our_topics(plotjuggler):
    seen = set()
    for plot in plotjuggler.iter('plot'):
        for curve in plot.findall('curve'):
            is_xy = plot.get('mode') == 'XYPlot'
            assert is_xy or plot.get('mode') == 'TimeSeries'
            names = [curve.get('curve_x'), curve.get('curve_y')] if is_xy else [curve.get('name')]
            for name in names:
                assert is_number(*split_name(name)), name
            seen.update(names)
    topics = ('displacement', 'simulated_displacement', 'residual')
    channels = ('delta_x', 'delta_y', 'gamma')
    assert {f'/ring/{topic}/{channel}' for topic in topics for channel in channels} <= seen


def panels(layout):
    if isinstance(layout, str):
        return [layout]
    assert layout['direction'] in ('row', 'column')
    assert 0 < layout['splitPercentage'] < 100
    return panels(layout['first']) + panels(layout['second'])


def test_foxglove_shows_every_panel_once_and_plots_fields_of_our_topics():
    document = json.loads((CONFIG / 'foxglove.json').read_text())
    assert sorted(panels(document['layout'])) == sorted(document['configById'])
    for name, panel in document['configById'].items():
        kind = name.partition('!')[0]
        if kind == 'Plot':
            for path in panel['paths']:
                topic, *fields = path['value'].split('.')
                assert is_number(topic, fields), path['value']
                assert path['timestampMethod'] == 'headerStamp'
        elif kind == 'DiagnosticSummary':
            assert panel['topicToRender'] == '/diagnostics'
        else:
            assert kind == 'RawMessages'
            assert panel['topicPath'] in TYPES
