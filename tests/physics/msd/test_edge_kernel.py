"""The edge-list kernels against the grid kernel and finite differences."""

from __future__ import annotations

import numpy as np
import pytest

from physics import jit
from physics.load import Press, ramped
from physics.mechanics import Mechanics
from physics.mesh import contact_normal
from physics.msd.autograd import tissue_rollout
from physics.msd.compiled import Case, _within, graph_reach, watched_rollout
from physics.msd.cone import exact_radii
from physics.msd.spring_graph import spring_graph
from tests.physics.sheets import gripped, pressed, sheet

pytestmark = pytest.mark.skipif(not jit.COMPILED, reason="numba isn't installed")


MESH = sheet(12, 13)
LOADS = {
    "vertex": pressed(MESH, 70, 20, 60),
    "patch": Press.on_patch(MESH, 70, 2.5, contact_normal(MESH, 70), ramped(8, 20, 8, 60)),
    "grip": gripped(MESH, [70, 58, 71], 0.15, 60),
}


def case_of(mechanics: Mechanics, load="vertex", theta=(0.7, 0.05, -0.1), watch=(70,)) -> Case:
    return Case(np.array(theta), MESH, LOADS[load], mechanics, np.array(watch))


@pytest.mark.parametrize("scheme", ["euler", "dkd"])
@pytest.mark.parametrize("load", LOADS)
def test_edge_list_equals_grid(load, scheme):
    case = case_of(Mechanics(scheme=scheme, anchor=0.2), load, watch=(70, 71, 43, 3))
    graph = spring_graph(case.mesh, case.load.vertices, case.watch, 61, case.theta.dtype)
    radii = exact_radii(60, graph_reach(case, graph))
    expected = watched_rollout(case, sensitive=True)
    forward = _within(case, graph, radii, sensitive=False)
    seen = _within(case, graph, radii, sensitive=True)
    np.testing.assert_allclose(forward.path, expected.path, atol=1e-14)
    np.testing.assert_allclose(seen.path, expected.path, atol=1e-14)
    np.testing.assert_allclose(seen.slopes, expected.slopes, atol=1e-12 * np.abs(expected.slopes).max())
    assert len(forward.slopes) == len(forward.elastic) == 0


@pytest.mark.parametrize("mechanics", [
    Mechanics(),
    Mechanics(scheme="dkd", anchor=0.4, boundary="free"),
], ids=["euler", "dkd"])  # fmt: skip
@pytest.mark.parametrize("load", LOADS)
def test_adjoint_equals_finite_differences(load, mechanics):
    case = case_of(mechanics, load, watch=(70, 72, 30))
    random = np.random.default_rng(3)
    count = len(case.mesh.vertices)
    fields = [0.4 + 0.4 * random.random(count), 0.02 + 0.1 * random.random(count)]
    weights = random.standard_normal((60, 3, 3))
    slopes = tissue_rollout(case, *fields)[1](weights)
    for which, vertices in ((0, (70, 71, 57, 30)), (1, (70, 58, 83, 0))):
        for vertex in vertices:
            values = []
            for sign in (1, -1):
                moved = [field.copy() for field in fields]
                moved[which][vertex] += sign * 1e-5
                values.append((weights * tissue_rollout(case, *moved)[0]).sum())
            central = (values[0] - values[1]) / 2e-5
            assert slopes[which][vertex] == pytest.approx(central, rel=1e-6, abs=1e-9)
    pushes = [case._replace(theta=case.theta + np.array([0, 0, sign * 1e-6])) for sign in (1, -1)]
    plus, minus = ((weights * tissue_rollout(push, *fields)[0]).sum() for push in pushes)
    assert slopes[2] == pytest.approx((plus - minus) / 2e-6, rel=1e-6)
    assert (slopes[2] == 0) == (load == "grip")


@pytest.mark.parametrize("load", LOADS)
def test_uniform_fields_are_the_uniform_rollout(load):
    case = case_of(Mechanics(), load, watch=(70, 72))
    count = len(case.mesh.vertices)
    trajectory, way_back = tissue_rollout(case, np.full(count, case.theta[0]), np.full(count, case.theta[1]))
    uniform = watched_rollout(case, sensitive=True)
    np.testing.assert_allclose(trajectory, uniform.path, atol=1e-15)
    weights = np.random.default_rng(1).standard_normal((60, 2, 3))
    stiffness, damping, force = way_back(weights)
    expected = np.einsum("tmc,tmcp->p", weights, uniform.slopes)
    np.testing.assert_allclose([stiffness.sum(), damping.sum(), force], expected, rtol=1e-10)
