"""The edge-list kernels against the grid kernel and finite differences."""

from __future__ import annotations

import numpy as np
import pytest
from sheets import sheet

from physics import jit
from physics.cone import exact_radii
from physics.mechanics import Mechanics
from physics.mesh import contact_normal
from physics.msd_autograd import FieldRun
from physics.msd_compiled import Case, _within, contact_rollout
from physics.msd_kernel import load_profile
from physics.spring_graph import spring_graph

pytestmark = pytest.mark.skipif(not jit.COMPILED, reason="numba isn't installed")


def case_of(mechanics: Mechanics, theta=(0.7, 0.05, -0.1), dtype=np.float64) -> Case:
    mesh, vertex = sheet(12, 13), 70
    direction = contact_normal(mesh, vertex)
    return Case(np.array(theta, dtype), mesh, vertex, direction, load_profile(mechanics), mechanics)


@pytest.mark.parametrize("scheme", ["euler", "dkd"])
def test_edge_list_equals_grid(scheme):
    mechanics = Mechanics(scheme=scheme, anchor=0.2, steps=80, load_steps=20)
    case, radii = case_of(mechanics), exact_radii(80)
    graph = spring_graph(case.mesh, case.vertex, int(radii.max()), case.theta.dtype)
    expected, expected_jacobian = contact_rollout(case, sensitive=True)
    forward, _ = _within(case, graph, radii, sensitive=False)
    trajectory, jacobian = _within(case, graph, radii, sensitive=True)
    np.testing.assert_allclose(forward, expected, atol=1e-14)
    np.testing.assert_allclose(trajectory, expected, atol=1e-14)
    np.testing.assert_allclose(jacobian, expected_jacobian, atol=1e-12 * np.abs(expected_jacobian).max())


@pytest.mark.parametrize("mechanics", [
    Mechanics(steps=60, load_steps=20),
    Mechanics(steps=60, load_steps=20, scheme="dkd", anchor=0.4, boundary="free"),
], ids=["euler", "dkd"])  # fmt: skip
def test_adjoint_equals_finite_differences(mechanics):
    case = case_of(mechanics)
    random = np.random.default_rng(3)
    count = len(case.mesh.vertices)
    fields = [0.4 + 0.4 * random.random(count), 0.02 + 0.1 * random.random(count)]
    weights = random.standard_normal((60, 3))
    slopes = FieldRun(case, *fields).slopes(weights)
    for which, vertices in ((0, (70, 71, 57, 30)), (1, (70, 58, 83, 0))):
        for vertex in vertices:
            values = []
            for sign in (1, -1):
                moved = [field.copy() for field in fields]
                moved[which][vertex] += sign * 1e-5
                values.append((weights * FieldRun(case, *moved).trajectory).sum())
            central = (values[0] - values[1]) / 2e-5
            assert slopes[which][vertex] == pytest.approx(central, rel=1e-6, abs=1e-9)
    pushes = [case._replace(theta=case.theta + np.array([0, 0, sign * 1e-6])) for sign in (1, -1)]
    plus, minus = ((weights * FieldRun(push, *fields).trajectory).sum() for push in pushes)
    assert slopes[2] == pytest.approx((plus - minus) / 2e-6, rel=1e-6)


def test_uniform_fields_are_the_uniform_rollout():
    case = case_of(Mechanics(steps=60, load_steps=20))
    count = len(case.mesh.vertices)
    run = FieldRun(case, np.full(count, case.theta[0]), np.full(count, case.theta[1]))
    trajectory, jacobian = contact_rollout(case, sensitive=True)
    np.testing.assert_allclose(run.trajectory, trajectory, atol=1e-15)
    weights = np.random.default_rng(1).standard_normal((60, 3))
    stiffness, damping, force = run.slopes(weights)
    expected = np.einsum("tc,tcp->p", weights, jacobian)
    np.testing.assert_allclose([stiffness.sum(), damping.sum(), force], expected, rtol=1e-10)
