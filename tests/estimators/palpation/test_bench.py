"""A body with its palpations on a finer mesh."""

import dataclasses

import numpy as np
import pytest

from palpate.estimators.palpation import bench as benches
from palpate.estimators.palpation.bench import Bench
from palpate.evaluation.palpation.synthetic import BODIES, observe, press

BODY = dataclasses.replace(BODIES["slab"], size=0.08)


@pytest.fixture
def bench() -> Bench:
    seen = observe(*press(BODY, 1e4, 0.42, 0.5, (0.1, 0.5), 4, law="linear"), "stereo", 3, count=800)
    return Bench(*BODY.skin(4, BODY.size / 20), [seen], "linear")


def test_eight_times_as_many_elements_fill_the_same_body_under_the_same_force(bench: Bench) -> None:
    coarse, forces = bench.skin, bench.forces[0]
    (before,) = bench.linear(1e4, 0.4)
    bench.refine()
    skin = bench.skin
    assert len(skin.body.elements) == 8 * len(coarse.body.elements)
    np.testing.assert_array_equal(skin.body.rest[: len(coarse.body.rest)], coarse.body.rest)
    assert skin.body.volumes.sum() == pytest.approx(coarse.body.volumes.sum())
    low = skin.body.rest[:, 2] == skin.body.rest[:, 2].min()
    np.testing.assert_array_equal(bench.held, np.repeat(low[:, None], 3, axis=1))
    np.testing.assert_allclose(bench.forces[0].sum(axis=0), forces.sum(axis=0), atol=1e-12)
    (after,) = bench.linear(1e4, 0.4)
    # A finer mesh gives way more.
    dents = [
        float((body.vertices - body.moved(rest.displacement))[:, 2].max())
        for body, rest in ((coarse, before), (skin, after))
    ]
    assert 1 < dents[1] / dents[0] < 1.3


def test_a_body_that_may_become_too_large_stays(bench: Bench, monkeypatch: pytest.MonkeyPatch) -> None:
    skin = bench.skin
    monkeypatch.setattr(benches, "FACTORED", 8 * skin.body.rest.size - 1)
    with pytest.raises(ValueError, match=f"a finer mesh may have {8 * skin.body.rest.size} unknowns, more than"):
        bench.refine()
    assert bench.skin is skin
    monkeypatch.setattr(benches, "FACTORED", 8 * skin.body.rest.size)
    bench.refine()
    assert skin.body.rest.size < bench.skin.body.rest.size <= benches.FACTORED
