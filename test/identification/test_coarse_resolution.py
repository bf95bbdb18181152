"""Probes behind a coarse converter: intervals count the rounding and hold the truth."""

from dataclasses import replace

import numpy as np
from other_rigs import virtual_run
import pytest

from saddlering_ros.identification import identify
from saddlering_ros.record import LOAD_TOPIC, PROBE_TOPICS
from saddlering_ros.record.quality import topic_quality
from saddlering_ros.rig import default_rig, TRUE_TO_SCALE

RIG = default_rig()


@pytest.fixture(name='runs', scope='module')
def runs_fixture():
    return [virtual_run(RIG, 'static', hold=2.0, step=RIG.full_scale_load / 12.0),
            virtual_run(RIG, 'dynamic', duration=6.0)]


def rounded(run, step):
    gaps = step * np.rint(run.gaps / step)
    quality = {name: topic_quality(run.stamps[known], row[known])
               for name, row in zip(PROBE_TOPICS, gaps, strict=True)
               for known in [np.isfinite(row)]}
    quality[LOAD_TOPIC] = topic_quality(run.stamps, run.load)
    return replace(run, gaps=gaps, quality=quality)


@pytest.mark.parametrize('step', [0.5e-6, 5e-6])
def test_the_truth_lies_in_the_intervals_at_a_resolution_of(step, runs):
    found = identify([rounded(run, step) for run in runs], RIG)
    error = found.parameters.contact.to_array() - TRUE_TO_SCALE.to_array()
    determined = np.array(list(found.determined.values()))
    assert found.determined['D1']
    assert (np.abs(error) < 3.0 * found.std)[determined].all()
    assert np.isfinite(found.parameters.contact.to_array()).all()
