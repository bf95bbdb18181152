"""Results name the bytes and the versions they were made from."""

import json
import shutil
import subprocess
from types import SimpleNamespace

from pyarrow import parquet
import pytest

from saddlering_ros import __version__, DiagnosisResult, rig
from saddlering_ros.bags.reader import bag_info, read_run
from saddlering_ros.cli.main import main
from saddlering_ros.files import Origin, sha256_of_file, share_directory, versions_in_use
from saddlering_ros.rig import default_rig, ParameterSet, read_parameters, TRUE_TO_SCALE

BAG = share_directory() / 'bags' / 'static_50'


@pytest.fixture
def parameters(tmp_path):
    path = tmp_path / 'parameters.yaml'
    rig.write_parameters(path, ParameterSet(TRUE_TO_SCALE))
    return path


def hash_by_shell(folder) -> str:
    """What docs/bags.md tells its reader to type."""
    done = subprocess.run('sha256sum * | sha256sum', shell=True, cwd=folder, check=True,
                          env={'LC_ALL': 'C', 'PATH': '/usr/bin:/bin'}, capture_output=True)
    return done.stdout.split()[0].decode()


def test_the_hash_of_a_bag_can_be_made_by_hand():
    assert read_run(BAG).sha256 == bag_info(BAG).sha256 == hash_by_shell(BAG)


def test_a_bare_file_has_the_hash_of_its_bytes():
    file = BAG / 'static_50_0.mcap'
    assert read_run(file).sha256 == sha256_of_file(file)


def test_another_fact_is_another_bag(tmp_path):
    copy = shutil.copytree(BAG, tmp_path / 'bag')
    metadata = copy / 'metadata.yaml'
    metadata.write_text(metadata.read_text() + '\n# a word\n')
    assert read_run(copy).sha256 != read_run(BAG).sha256


def test_commands_put_bags_files_and_versions_into_what_they_write(tmp_path, parameters, capsys):
    out = tmp_path / 'simulated.parquet'
    assert main(['simulate', str(BAG), '--params', str(parameters), '--out', str(out),
                 '--json', '-']) == 0
    made = json.loads(capsys.readouterr().out)['provenance']
    assert made['bags'] == [{'path': str(BAG), 'sha256': hash_by_shell(BAG)}]
    assert made['files'] == [{'path': str(parameters), 'sha256': sha256_of_file(parameters)}]
    assert made['versions']['saddlering_ros'] == __version__
    assert {'code', 'python', 'numpy', 'scipy', 'numba'} <= set(made['versions'])
    assert json.loads(parquet.read_schema(out).metadata[b'saddlering.provenance']) == made

    assert main(['validate', str(BAG), '--params', str(parameters), '--json', '-']) == 0
    assert json.loads(capsys.readouterr().out)['provenance'] == made


def test_identified_parameters_carry_the_hashes_of_their_bags(tmp_path, capsys):
    out = tmp_path / 'found.yaml'
    assert main(['identify', str(BAG), '--particles', '4', '--iterations', '2', '--out', str(out),
                 '--json', '-']) == 0
    made = json.loads(capsys.readouterr().out)['provenance']
    source = read_parameters(out).source
    assert made['bags'] == [{'path': str(BAG), 'sha256': hash_by_shell(BAG)}]
    assert [(origin.path, origin.sha256) for origin in source.origins] == [
        (str(BAG), hash_by_shell(BAG))]
    assert f'code {versions_in_use()["code"]}' in source.versions


def test_the_files_of_a_diagnosis_are_listed_once_however_often_it_is_asked_for():
    verdict = SimpleNamespace(to_json=lambda: {'provenance': {'files': []}})
    result = DiagnosisResult((), default_rig(), (Origin('rig.yaml', 'ab'),), verdict)
    assert result.to_json() == result.to_json()
    assert result.document == verdict.to_json()
