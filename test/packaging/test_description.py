"""Claims about what describes the package: package.xml, setup.py, lock files, launch file."""

import ast
from importlib.metadata import PackageNotFoundError, version
import os
from pathlib import Path
import re
import runpy
import shutil
import subprocess
import sys
import types
import xml.etree.ElementTree as ElementTree

import pytest
from sources import imported
import yaml

import saddlering_ros
from saddlering_ros.ros.names import names

ROOT = Path(__file__).resolve().parents[2]

NODES = set(names())


def setup_arguments() -> dict[str, object]:
    """The keyword arguments that setup.py hands to setup()."""
    handed: dict[str, object] = {}
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr('setuptools.setup', lambda **arguments: handed.update(arguments))
        runpy.run_path(str(ROOT / 'setup.py'))
    return handed


@pytest.fixture(scope='module')
def arguments() -> dict[str, object]:
    pytest.importorskip('setuptools')
    return setup_arguments()


def manifest(folder: str = '.') -> ElementTree.Element:
    return ElementTree.parse(ROOT / folder / 'package.xml').getroot()


def text(element: ElementTree.Element, name: str) -> str:
    found = element.find(name)
    assert found is not None
    return found.text or ''


@pytest.mark.parametrize('field', ['name', 'version', 'license', 'maintainer_email'])
def test_setup_py_and_package_xml_agree(arguments, field):
    root = manifest()
    maintainer = root.find('maintainer')
    assert maintainer is not None
    said = maintainer.get('email') if field == 'maintainer_email' else text(root, field)
    assert arguments[field] == said


def test_every_place_says_the_same_version():
    assert text(manifest(), 'version') == saddlering_ros.__version__
    assert text(manifest('saddlering_interfaces'), 'version') == saddlering_ros.__version__


def test_the_change_logs_begin_with_this_version():
    number = re.escape(saddlering_ros.__version__)
    said = (ROOT / 'CHANGELOG.md').read_text(encoding='utf-8')
    date = re.search(rf'^## {number} - ([\d-]+)$', said, re.M)
    assert date
    assert date.start() == re.search('^## ', said, re.M).start()
    assert re.findall('^### (.*)$', said, re.M)[:4] == ['Added', 'Changed', 'Fixed', 'Removed']
    for folder in ('.', 'saddlering_interfaces'):
        bloom = (ROOT / folder / 'CHANGELOG.rst').read_text(encoding='utf-8')
        assert re.search(r'^(\S.*)\n-+$', bloom, re.M)[1] == (
            f'{saddlering_ros.__version__} ({date[1]})')


@pytest.mark.parametrize(('folder', 'build_type'), [
    ('.', 'ament_python'), ('saddlering_interfaces', 'ament_cmake')])
def test_manifests_are_what_colcon_needs(folder, build_type):
    assert manifest(folder).get('format') == '3'
    assert text(manifest(folder), 'export/build_type') == build_type


def test_every_node_has_an_executable(arguments):
    scripts = dict(re.split(r'\s*=\s*', line) for line in
                   arguments['entry_points']['console_scripts'])
    expected = {node: f'saddlering_ros.nodes.{node}:main' for node in NODES}
    assert scripts == {**expected, 'saddlering': 'saddlering_ros.cli.main:main'}


@pytest.mark.parametrize('folder', ['launch', 'config', 'bags'])
def test_every_shared_file_is_installed(arguments, folder):
    installed = {name for _, names in arguments['data_files'] for name in names}
    there = {str(path.relative_to(ROOT)) for path in (ROOT / folder).rglob('*')
             if path.is_file() and '__pycache__' not in path.parts}
    assert there
    assert there <= installed


def test_ros_is_an_extra_and_never_required(arguments):
    assert not [name for name in arguments['install_requires'] if name.startswith('ros-')]
    assert any(name.startswith('ros-jazzy-rclpy') for name in arguments['extras_require']['ros'])


def test_what_the_package_imports_is_declared(arguments):
    declared = {name.lower() for name in arguments['install_requires']}
    declared |= set(arguments['extras_require']['cluster'])
    modules = {'yaml': 'pyyaml', 'llvmlite': 'numba', 'PIL': 'pillow'}
    optional = {'exudyn', 'ament_index_python', 'pandas', 'polars'}
    from_ros = {depend.text for depend in manifest().iter('exec_depend')}
    found = {module.partition('.')[0] for path in (ROOT / 'saddlering_ros').rglob('*.py')
             for module, _ in imported(path)} - set(sys.stdlib_module_names)
    unknown = {name for name in found if modules.get(name, name) not in declared | from_ros}
    assert unknown - optional <= {'saddlering_ros'}


@pytest.mark.parametrize('python', ['3.10', '3.11', '3.12', '3.13'])
@pytest.mark.parametrize('kind', ['wheels', 'test', 'docs', 'coverage'])
def test_every_python_has_exact_pins(python, kind):
    lines = (ROOT / 'requirements' / 'lock' / f'{python}-{kind}.txt').read_text().splitlines()
    pins = [line for line in lines if not line.startswith('#')]
    assert pins
    assert all(re.fullmatch(r'[\w.-]+==[\w.]+', pin) for pin in pins)


@pytest.mark.parametrize('python', ['3.10', '3.11', '3.12', '3.13'])
def test_pins_hold_what_the_package_requires(arguments, python):
    lock = (ROOT / 'requirements' / 'lock' / f'{python}-wheels.txt').read_text().lower()
    pinned = {line.split('==')[0] for line in lock.splitlines()}
    assert {name.lower() for name in arguments['install_requires']} <= pinned


def test_the_registry_lists_every_module_of_nodes():
    modules = {path.stem for path in (ROOT / 'saddlering_ros' / 'nodes').glob('*.py')}
    assert modules - {'__init__'} == NODES


@pytest.mark.parametrize('file', ['setup.py', 'launch/rig.launch.py', 'docs/generate.py',
                                  'saddlering_ros/ros/launcher.py'])
def test_nobody_else_keeps_a_list_of_nodes(file):
    items = ast.walk(ast.parse((ROOT / file).read_text()))
    strings = {item.value for item in items if isinstance(item, ast.Constant)}
    assert len(strings & NODES) <= 3  # those that are started otherwise than their kind


def test_a_new_node_is_a_module_and_an_entry(tmp_path):
    """What set-up, launcher and docs make of a tree with one more node."""
    shutil.copytree(ROOT / 'saddlering_ros', tmp_path / 'saddlering_ros',
                    ignore=shutil.ignore_patterns('__pycache__', 'ring', 'report'))
    for name in ('setup.py', 'README.md', 'requirements', 'resource', 'package.xml', 'launch',
                 'config'):
        copy = shutil.copytree if (ROOT / name).is_dir() else shutil.copy
        copy(ROOT / name, tmp_path / name)
    (tmp_path / 'bags').mkdir()
    (tmp_path / 'saddlering_ros' / 'nodes' / 'inclinometer.py').write_text('def main(): ...\n')
    registry = tmp_path / 'saddlering_ros' / 'ros' / 'names.py'
    registry.write_text(registry.read_text().replace('NODES = (\n', (
        "NODES = (\n    NodeEntry('inclinometer', 'Inclinometer', RING, 'a bus', "
        "'rig/elevation'),\n"), 1))
    code = ('import setuptools, runpy\n'
            'setuptools.setup = lambda **given: print(given["entry_points"])\n'
            'runpy.run_path("setup.py")\n'
            'from saddlering_ros.ros.names import names\n'
            'print(names("ring"))\n')
    said = subprocess.run([sys.executable, '-c', code], cwd=tmp_path, capture_output=True,
                          text=True, check=True, env={**os.environ, 'PYTHONPATH': str(tmp_path)})
    assert 'inclinometer = saddlering_ros.nodes.inclinometer:main' in said.stdout
    assert "('inclinometer', 'ring_displacement'" in said.stdout


class Made:
    """What a launch file makes: its kind, and what it was given."""

    def __init__(self, *values, **given):
        self.values, self.given = values, given

    def perform(self, context):
        return context[self.values[0]]


@pytest.fixture
def launched(monkeypatch):
    """The nodes that the launch file starts for some arguments, with stand-ins for launch."""
    kinds = {name: type(name, (Made,), {}) for name in (
        'LaunchDescription', 'DeclareLaunchArgument', 'ExecuteProcess', 'OpaqueFunction',
        'LaunchConfiguration', 'PathJoinSubstitution', 'LifecycleNode', 'Node',
        'FindPackagePrefix', 'FindPackageShare')}
    for module in ('launch', 'launch.actions', 'launch.substitutions', 'launch_ros',
                   'launch_ros.actions', 'launch_ros.substitutions'):
        monkeypatch.setitem(sys.modules, module, types.SimpleNamespace(**kinds))
    found = runpy.run_path(str(ROOT / 'launch' / 'rig.launch.py'))
    arguments = found['generate_launch_description']().values[0]
    defaults = {item.values[0]: item.given['default_value'] for item in arguments
                if isinstance(item, kinds['DeclareLaunchArgument'])}

    def start(**given):
        made = found['start_nodes']({**defaults, 'rig': '/rig.yaml', **given})
        return {item.given.get('executable', 'record'): item for item in made}

    return start


def test_the_launch_file_leaves_out_what_is_not_wanted(launched):
    assert set(launched()) == set(names('ring', 'alarm', 'action'))
    assert set(launched(alarm='false')) == set(names('ring', 'action'))
    assert set(launched(bag='b')) == NODES
    assert set(launched(bag='b', replay='false', servers='false', alarm='false')) == set(
        names('ring'))
    assert 'record' in launched(record='out')


def test_the_launch_file_hands_everything_on(launched):
    nodes = launched(bag='/bags/b', namespace='rig1', elevation='60', log_level='warn',
                     respawn='true', autostart='false', hydraulic_load_topic='mine/load')
    for name, node in nodes.items():
        assert node.given['namespace'] == '/rig1'
        assert node.given['respawn'] is True
        assert node.given['arguments'] == ['--ros-args', '--log-level', 'warn']
        assert ('rig/hydraulic_load', 'mine/load') in node.given['remappings']
        assert ('/clock', '/rig1/clock') in node.given['remappings']
        kind = 'Node' if name in names('action') else 'LifecycleNode'
        assert type(node).__name__ == kind
    merged = {name: {key: value for part in node.given['parameters'][1:]
                     for key, value in part.items()} for name, node in nodes.items()}
    assert merged['ring_simulator']['elevation_deg'] == 60.0
    assert merged['replay_clock']['elevation_deg'] == 60.0
    assert merged['ring_displacement']['elevation_deg'] == 60.0
    assert merged['ring_residual']['autostart'] is False
    assert merged['ring_alarm'] == {**merged['ring_residual'], 'materiality': 2.0,
                                    'false_alarm_hours': 1000.0}
    assert 'ring_alarm' in merged['replay_clock']['participants']
    assert merged['hydraulic_load']['bag'] == '/bags/b'


def test_a_recording_of_the_launch_file_states_its_test(launched):
    words = launched(record='out', elevation='60', test='static')['record'].given['cmd']
    assert words[-4:] == ['--test', 'static', '--elevation', '60']
    assert '--test' not in launched(record='out')['record'].given['cmd']
    with pytest.raises(RuntimeError, match='needs test:='):
        launched(record='out', elevation='60')


def test_the_launch_file_publishes_frames_and_groups_diagnostics_on_request(launched):
    rig = str(ROOT / 'config' / 'rig.yaml')
    nodes = launched(rig=rig, transforms='true', analyzers='true', elevation='60')
    assert nodes['aggregator_node'].given['package'] == 'diagnostic_aggregator'
    arguments = nodes['static_transform_publisher'].given['arguments']  # of the last frame
    given = dict(zip(arguments[::2], arguments[1::2], strict=True))
    assert given['--frame-id'] == 'ring'
    assert given['--child-frame-id'] == 'hydraulic_cylinder'
    assert (given['--x'], given['--y'], given['--z']) == ('0.15', '1.0', '0.0')
    assert float(given['--qz']) == pytest.approx(-0.5)
    of_rig_1 = launched(rig=rig, transforms='true', elevation='60', namespace='rig1')
    words = of_rig_1['static_transform_publisher'].given['arguments']
    assert words[-4:] == ['--frame-id', 'rig1/ring', '--child-frame-id', 'rig1/hydraulic_cylinder']
    displacement = of_rig_1['ring_displacement'].given
    assert displacement['parameters'][-2:] == [
        {'frame_id': 'rig1/ring'}, {'displaced_frame_id': 'rig1/ring_displaced'}]
    assert ('/tf', '/rig1/tf') in displacement['remappings']
    assert {'frame_id': 'ring'} in nodes['ring_alarm'].given['parameters']
    assert {'tf2_msgs', 'tf2_ros', 'diagnostic_aggregator'} <= {
        depend.text for depend in manifest().iter('exec_depend')}


@pytest.mark.parametrize('prefix', ['', '/rig1/'])
@pytest.mark.parametrize('node', sorted(NODES))
def test_every_nodes_statuses_have_one_group_of_the_analyzers(node, prefix):
    analyzers = yaml.safe_load((ROOT / 'config' / 'analyzers.yaml').read_text())
    groups = {name: group for name, group in analyzers['/**']['ros__parameters'].items()
              if isinstance(group, dict)}
    status = f'{prefix}{node}: state'
    assert [name for name, group in groups.items()
            if any(part in status for part in group['contains'])] in (
                ['ring'], ['servers'], ['replay'])


def test_a_debian_package_needs_nothing_that_only_pip_has():
    depends = [str(item.text) for item in manifest() if 'depend' in item.tag]
    assert 'python3-numpy' in depends
    assert not [name for name in depends if name.endswith('-pip')]


def test_a_workspace_holds_both_packages_side_by_side(tmp_path):
    made = subprocess.run([ROOT / 'tools' / 'workspace.sh', tmp_path / 'ws'], check=True,
                          capture_output=True, text=True)
    assert 'rosdep install --from-paths src --ignore-src' in made.stdout
    found = {path.parent.name for path in (tmp_path / 'ws' / 'src').glob('*/package.xml')}
    assert found == {'saddlering_ros', 'saddlering_interfaces'}
    inside = subprocess.run([ROOT / 'tools' / 'workspace.sh', ROOT / 'out'], check=False,
                            capture_output=True, text=True)
    assert inside.returncode == 2


def test_the_example_in_cpp_is_built_where_rclcpp_is(tmp_path):
    prefixes = os.environ.get('AMENT_PREFIX_PATH', '').split(os.pathsep)
    if not any((Path(prefix) / 'share' / 'rclcpp').is_dir() for prefix in prefixes):
        pytest.skip('rclcpp is not published as a wheel')
    source = ROOT / 'examples' / 'interlock_cpp'
    subprocess.run(['cmake', '-S', source, '-B', tmp_path], check=True)
    subprocess.run(['cmake', '--build', tmp_path], check=True)


def test_the_messages_are_those_of_this_version():
    pytest.importorskip('saddlering_interfaces')
    try:
        assert version('saddlering_interfaces') == saddlering_ros.__version__
    except PackageNotFoundError:
        pytest.skip('installed without metadata')
