"""Claims about the protocol of progress and cancel that the API and the action jobs share."""

import json
from pathlib import Path
import sys

import numpy as np
import pytest

sys.path.append(str(Path(__file__).parent.parent / 'identification'))
from identification_records import dynamic_run, RIG, static_run

from saddlering_ros import Cancelled, diagnose, identify, Progress
from saddlering_ros.bags.write import write_bag
from saddlering_ros.identification.result import Identification
from saddlering_ros.identification.settings import IdentificationSettings, SwarmSettings
from saddlering_ros.jobs import requests as identification_job
from saddlering_ros.jobs.requests import IdentificationRequest
from saddlering_ros.jobs.worker import Worker
from saddlering_ros.progress import SearchStep
from saddlering_ros.record.record import TestMetadata

QUICK = IdentificationSettings(swarm=SwarmSettings(particles=8, iterations=6), seed=1)


@pytest.fixture(scope='module')
def paths(tmp_path_factory):
    folder = tmp_path_factory.mktemp('bags')
    return tuple(
        str(write_bag(folder / run.name, TestMetadata(run.test, float(np.degrees(run.elevation))),
                      run.stamps, run.load, [run.stamps] * 4, list(run.gaps), RIG.probes))
        for run in (static_run(50.0, seed=1), dynamic_run(50.0, seconds=3.0, seed=2)))


def test_a_job_reports_what_the_api_reports(paths):
    from_job, from_api = [], []
    answer = identification_job.run(IdentificationRequest(paths, (), RIG, QUICK), from_job.append)
    found = identify(paths, rig=RIG, particles=8, iterations=6, seed=1,
                     on_progress=from_api.append)
    assert all(isinstance(item, Progress) for item in from_job)
    shared = [item for item in from_job if item.task != 'validate']
    assert shared == from_api
    last = {item.task: item.share for item in from_job}
    assert last == {'read': 1.0, 'identify': 1.0, 'validate': 1.0}  # show_progress ends its line
    assert isinstance(shared[-1].search, SearchStep)
    assert answer.parameters.contact == found.parameters.contact
    assert json.loads(answer.fields['report_json'])['parameters'] == found.to_json()['parameters']


def test_a_report_names_its_step_in_words():
    assert Progress('read', 'static_50', 0.5).words == 'read static_50'
    assert Progress('identify', 'refinement', 0.5).words == 'refinement'


def test_a_worker_that_is_cancelled_raises_as_the_api_does_with_the_law_that_is_complete(paths):
    worker, told = Worker('saddlering_ros.jobs.requests'), list[str]()
    request = IdentificationRequest(paths, (), RIG, QUICK)
    try:
        with pytest.raises(Cancelled) as late:
            worker.run(request, lambda progress: told.append(progress.task),
                       lambda: 'validate' in told,
                       lambda progress: 12.0 * identification_job.patience(progress))
        assert late.value.partial.parameters.contact.K1 > 0.0
        assert not late.value.partial.offered
        with pytest.raises(Cancelled) as early:
            worker.run(request, lambda _: None, lambda: True, identification_job.patience)
        assert early.value.partial is None
    finally:
        worker.close()


def test_reading_is_cancelled_too(paths):
    with pytest.raises(Cancelled, match='read: cancelled'):
        diagnose(paths, rig=RIG, is_cancelled=lambda: True)


def test_a_cancel_during_the_identification_of_a_diagnosis_gives_no_verdict(monkeypatch):
    from saddlering_ros.diagnosis import ring_diagnosis

    half_done = object.__new__(Identification)
    object.__setattr__(half_done, 'cancelled', True)
    monkeypatch.setattr(ring_diagnosis, 'identify_plain', lambda *_, **__: half_done)
    with pytest.raises(Cancelled):
        ring_diagnosis.diagnose_ring([static_run(50.0, seed=1)], rig=RIG)
