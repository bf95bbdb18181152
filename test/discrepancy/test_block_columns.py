"""Claims on columns kept as blocks: their products are those of whole columns, masks and all."""

import numpy as np
import pytest

from saddlering_ros.discrepancy import Channel, Model, Noise, Parameter, Run
from saddlering_ros.discrepancy.diagnosis import problem_of
from saddlering_ros.discrepancy.problem.metric import Block, BlockColumns, Metric, noise_metric


@pytest.fixture
def metric() -> Metric:
    """Two runs of two channels, one with a free offset and a gap in its samples."""
    random = np.random.default_rng(1)

    def run(name: str, count: int) -> Run:
        rows = random.normal(size=(2, count))
        rows[0, 10:20] = np.nan
        return Run(name, np.linspace(0.0, 5.0, count), {}, {'one': rows[0], 'two': rows[1]})

    channels = {
        'one': Channel(offset='free', noise=Noise.white(0.5)),
        'two': Channel(noise=Noise.spectrum(np.array([0.1, 1.0, 5.0]), np.array([1.0, 0.3, 0.1]))),
    }
    model = Model(lambda p, run: {}, {'a': Parameter(0.0, 1.0)}, channels=channels)
    problem = problem_of(model, [run('first', 60), run('second', 90)])
    return noise_metric(problem).with_offsets()


def test_products_of_blocks_are_those_of_whole_columns(metric: Metric) -> None:
    random = np.random.default_rng(2)
    problem = metric.problem
    index = [np.array([0, 1, 2]), np.array([1, 3]), np.array([0, 4]), np.array([2])]
    blocks, whole = [], np.zeros((problem.size, 5))
    for slot, (own, (_, _, part)) in enumerate(zip(index, problem.slices, strict=True)):
        plain = random.normal(size=(part.stop - part.start, own.size))
        blocks.append(Block(slot, own, plain))
        whole[part, own] += plain
    columns, white = BlockColumns(metric, blocks, 5), metric.whiten(whole)
    others = random.normal(size=(problem.size, 3))
    assert np.allclose(columns.gram, white.T @ white, rtol=1e-9)
    assert np.allclose(columns.products(others), white.T @ others, rtol=1e-9)
    assert np.allclose(columns.products(others[:, 0]), white.T @ others[:, 0], rtol=1e-9)
    assert np.allclose(columns.combined(np.arange(5.0)), whole @ np.arange(5.0))
