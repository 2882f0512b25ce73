"""A body with its palpations on a finer mesh."""

import dataclasses

import numpy as np
import pytest

from palpate.estimators.palpation import bench as benches
from palpate.estimators.palpation.bench import Bench
from palpate.estimators.palpation.skin import Skin
from palpate.evaluation.palpation.synthetic import BODIES, TOOL, observe, press
from palpate.physics.fem.meshing import around
from palpate.physics.fem.solid import EDGES

BODY = dataclasses.replace(BODIES["slab"], size=0.08)


@pytest.fixture
def bench() -> Bench:
    seen = observe(*press(BODY, 1e4, 0.42, 0.5, (0.1, 0.5), 4, law="linear"), "stereo", 3, count=800)
    return Bench(*BODY.skin(4, BODY.size / 20), [seen], "linear")


def test_elements_are_halved_under_the_tool_and_fill_the_same_body_under_the_same_force(
    bench: Bench, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(benches, "FACTORED", 8 * bench.skin.body.rest.size - 1)
    coarse, forces, contact = bench.skin, bench.forces[0], bench.palpations[0].contact
    (before,) = bench.linear(1e4, 0.4)
    shares = bench.refine()
    skin = bench.skin
    corners = 1 + coarse.body.elements[:, :4].max()
    np.testing.assert_allclose(skin.body.rest[:corners], coarse.body.rest[:corners], atol=1e-15)
    np.testing.assert_allclose(shares @ coarse.body.rest, skin.body.rest, atol=1e-15)
    assert skin.body.volumes.sum() == pytest.approx(coarse.body.volumes.sum())

    def longest(of: Skin, close: bool) -> np.ndarray:
        places = of.body.rest[of.body.elements[:, :4]]
        apart = np.linalg.norm(places.mean(axis=1) - contact, axis=1)
        edges = np.linalg.norm(places[:, EDGES[:, 0]] - places[:, EDGES[:, 1]], axis=2).max(axis=1)
        return edges[apart < 0.01 if close else apart > 0.045]

    assert longest(skin, True).max() == pytest.approx(longest(coarse, True).max() / 2)
    assert longest(skin, False).max() == pytest.approx(longest(coarse, False).max())
    assert len(coarse.body.elements) < len(skin.body.elements) < 7.5 * len(coarse.body.elements)
    low = skin.body.rest[:, 2] < 1e-12
    np.testing.assert_array_equal(bench.held, np.repeat(low[:, None], 3, axis=1))
    np.testing.assert_allclose(bench.forces[0].sum(axis=0), forces.sum(axis=0), atol=1e-12)
    # The start that shares give moves the surface as before, and a finer mesh gives way more.
    kept = skin.moved(shares @ before.displacement) - coarse.moved(before.displacement)
    assert np.abs(kept).max() < 1e-6 * np.abs(before.displacement).max()
    (after,) = bench.linear(1e4, 0.4)
    dents = [
        float((body.vertices - body.moved(rest.displacement))[:, 2].max())
        for body, rest in ((coarse, before), (skin, after))
    ]
    assert 1.05 < dents[1] / dents[0] < 1.3


def test_a_small_body_has_all_its_elements_halved(bench: Bench) -> None:
    coarse = bench.skin.body
    shares, fine = bench.refine(), bench.skin.body
    assert len(fine.elements) == 8 * len(coarse.elements)
    np.testing.assert_allclose(fine.rest[: len(coarse.rest)], coarse.rest, atol=1e-15)
    np.testing.assert_allclose((shares @ coarse.rest), fine.rest, atol=1e-15)


@pytest.mark.parametrize(("cells", "off"), [(3, 0.011), (4, 5e-4)])
def test_a_curved_body_stays_as_it_is(cells: int, off: float) -> None:
    """Elements of a ball whose curved ones were flat when divided between their nodes; one press near the side."""
    ball = BODIES["ball"]
    seen = observe(*press(ball, 1e4, 0.42, 0.5, (0.1, 0.5), 4, law="linear"), "stereo", 3, count=800)
    bench = Bench(*ball.skin(cells, ball.size / 26, around(seen.contact[None], TOOL, 0.6 * TOOL)), [seen], "linear")
    coarse = bench.skin
    shares = bench.refine()
    body = bench.skin.body
    assert body.weights.min() > 0
    # Some nodes of elements that are much curved went back half of their way, so that nothing is crushed.
    moved = np.linalg.norm(shares @ coarse.body.rest - body.rest, axis=1)
    assert np.mean(moved > 1e-12) < 0.05
    assert body.volumes.sum() == pytest.approx(coarse.body.volumes.sum(), rel=1e-3)
    assert len(body.rest) < 5 * len(coarse.body.rest)
    free = bench.skin.shares.sum(axis=1) > 0.5
    np.testing.assert_allclose((bench.skin.shares @ body.rest)[free], coarse.vertices[free], atol=off)


def test_a_body_that_becomes_too_large_stays(bench: Bench, monkeypatch: pytest.MonkeyPatch) -> None:
    skin = bench.skin
    monkeypatch.setattr(benches, "FACTORED", skin.body.rest.size)
    with pytest.raises(ValueError, match=r"a finer mesh has \d+ unknowns, more than") as caught:
        bench.refine()
    assert bench.skin is skin
    monkeypatch.setattr(benches, "FACTORED", int(str(caught.value).split()[4]))
    bench.refine()
    assert skin.body.rest.size < bench.skin.body.rest.size == benches.FACTORED
