"""Rest under loads against closed forms, and all derivatives against finite differences."""

import dataclasses

import numpy as np
import pytest
import skfem
from skfem.helpers import ddot, sym_grad, trace

from palpate.physics.fem import LAWS, Material, NoEquilibrium, Solid, box, find_equilibrium, linear_system, make_solid
from tests.physics.fem.bodies import block, clamped

STEP = 1e-5


def pulled(body: Solid) -> np.ndarray:
    """Forces askew on the face x = 1, of 1 N in all [N, 3]."""
    forces, end = np.zeros_like(body.rest), np.isclose(body.rest[:, 0], 1)
    forces[end] = np.array([0.6, 0.0, -0.8]) / end.sum()
    return forces


@pytest.mark.parametrize("law", LAWS)
@pytest.mark.parametrize("order", [1, 2])
def test_patch_test(law: str, order: int) -> None:
    """Whatever the mesh, an affine motion of the surface is that of the inside."""
    body = block(3, order, seed=1)
    rim = np.repeat(((body.rest < 1e-9) | (body.rest > 1 - 1e-9)).any(axis=1)[:, None], 3, axis=1)
    motion = body.rest @ (0.1 * np.random.default_rng(0).normal(size=(3, 3))).T
    found = find_equilibrium(body, Material(law, 1e3, 0.4), rim, motion=motion)
    np.testing.assert_allclose(found.displacement, motion, atol=1e-8)
    np.testing.assert_allclose(found.reaction.sum(axis=0), 0, atol=1e-8)


def test_the_linear_law_is_scikit_fem_s() -> None:
    """Another program's assembly and solver, on the same linear tetrahedra."""
    body = make_solid(*box((1.0, 1.0, 1.0), (3, 3, 3)))
    held, forces, material = clamped(body), pulled(body), Material("linear", 1e3, 0.4)
    mu, lam = material.lame
    basis = skfem.Basis(skfem.MeshTet(body.rest.T, body.elements.T), skfem.ElementVector(skfem.ElementTetP1()))

    @skfem.BilinearForm
    def stiffness(u, v, _):
        return lam * trace(sym_grad(u)) * trace(sym_grad(v)) + 2 * mu * ddot(sym_grad(u), sym_grad(v))

    order = np.empty(held.size, int)  # of our components among those of scikit-fem
    order[basis.nodal_dofs.T.ravel()] = np.arange(held.size)
    system = skfem.condense(stiffness.assemble(basis), forces.ravel()[order], D=np.flatnonzero(held.ravel()[order]))
    expected = skfem.solve(*system)[basis.nodal_dofs].T
    found = find_equilibrium(body, material, held, forces=forces).displacement
    np.testing.assert_allclose(found, expected, atol=1e-6 * np.abs(expected).max())


def test_a_bent_bar_takes_its_moment_at_the_order_of_the_elements() -> None:
    """Pure bending, u = (xz, -νyz, -(x² + ν(z² - y²))/2)/R, needs the moment E I/R; quadratic elements hold it."""
    young, ratio, radius = 1e5, 0.3, 50.0

    def moment(cells: int, order: int) -> float:
        nodes, tetrahedra = box((4.0, 1.0, 1.0), (4 * cells, cells, cells))
        body = make_solid(nodes - [0, 0.5, 0.5], tetrahedra, order=order)
        x, y, z = body.rest.T
        exact = np.stack([x * z, -ratio * y * z, -(x**2 + ratio * (z**2 - y**2)) / 2], axis=1) / radius
        ends = np.repeat((np.isclose(x, 0) | np.isclose(x, 4))[:, None], 3, axis=1)
        found = find_equilibrium(body, Material("linear", young, ratio), ends, motion=exact)
        end = np.isclose(x, 4)
        return float((found.reaction[end, 0] * z[end]).sum())

    exact = young / 12 / radius
    errors = [moment(cells, 1) / exact - 1 for cells in (2, 4, 8)]
    orders = np.log2(np.divide(errors[:-1], errors[1:]))
    assert (orders > 1.8).all(), (errors, orders)
    assert (orders < 2.2).all()
    assert moment(2, 2) == pytest.approx(exact, rel=1e-9)


def test_a_cantilever_sinks_as_timoshenko_says() -> None:
    """w = F L³/(3 E I) + F L/(κ A G), with ν = 0, so that the clamp holds no side that would shrink."""
    body = make_solid(*box((10.0, 1.0, 1.0), (20, 2, 2)), order=2)
    end = np.isclose(body.rest[:, 0], 10)
    forces = np.zeros_like(body.rest)
    forces[end, 2] = 1.0 / end.sum()
    found = find_equilibrium(body, Material("linear", 1e6, 0.0), clamped(body), forces=forces)
    sunk = 10**3 / (3 * 1e6 / 12) + 10 / (5 / 6 * 1e6 / 2)
    assert found.displacement[end, 2].mean() == pytest.approx(sunk, rel=2e-3)
    np.testing.assert_allclose(found.reaction.sum(axis=0), [0, 0, -1], atol=1e-8)


def boussinesq(places: np.ndarray, young: float, ratio: float) -> np.ndarray:
    """Displacement of a half-space z ≤ 0 under a unit force along -z at the origin, at places [..., 3]."""
    x, y, depth = places[..., 0], places[..., 1], -places[..., 2]
    far = np.linalg.norm(places, axis=-1)
    across = depth / far**3 - (1 - 2 * ratio) / (far * (far + depth))
    down = 2 * (1 - ratio) / far + depth**2 / far**3
    return (1 + ratio) / (2 * np.pi * young) * np.stack([x * across, y * across, -down], axis=-1)


@pytest.mark.slow
def test_hertz_indentation_converges_at_second_order() -> None:
    """A sphere's pressure p₀ √(1 - r²/a²) does the work 4 π² p₀² a³/(15 E*); the outside is prescribed."""
    young, ratio, peak = 1.0, 0.3, 0.01
    around, across = np.meshgrid((np.arange(64) + 0.5) * np.pi / 32, (np.arange(60) + 0.5) / 60)
    falls = np.sqrt(1 - across**2)
    sources = np.stack([across * np.cos(around), across * np.sin(around), 0 * across], axis=-1).reshape(-1, 3)
    shares = (peak * falls * across * np.pi / 32 / 60).ravel()
    shares *= 2 * np.pi * peak / 3 / shares.sum()

    def work(cells: int) -> float:
        nodes, tetrahedra = box((2.0, 2.0, 2.0), (cells, cells, cells))
        body = make_solid(nodes - [0, 0, 2.0], tetrahedra)
        x, y, z = body.rest.T
        outer = np.isclose(x, 2) | np.isclose(y, 2) | np.isclose(z, -2)
        held = np.repeat(outer[:, None], 3, axis=1)
        held[np.isclose(x, 0), 0] = held[np.isclose(y, 0), 1] = True
        motion = np.zeros_like(body.rest)
        motion[outer] = [shares @ boussinesq(place - sources, young, ratio) for place in body.rest[outer]]
        motion[np.isclose(x, 0), 0] = motion[np.isclose(y, 0), 1] = 0.0
        forces, top = np.zeros_like(body.rest), body.faces[np.isclose(z[body.faces], 0).all(axis=1)]
        weights = np.array([[i + 1 / 3, j + 1 / 3] for i in range(24) for j in range(24 - i)])
        weights = np.concatenate([weights, [[i + 2 / 3, j + 2 / 3] for i in range(23) for j in range(23 - i)]]) / 24
        weights = np.column_stack([weights, 1 - weights.sum(axis=1)])
        places = np.einsum("sk,tki->tsi", weights, body.rest[top])
        pressure = peak * np.sqrt(np.maximum(1 - np.square(places[..., :2]).sum(-1), 0))
        area = (2.0 / cells) ** 2 / 2 / len(weights)
        np.add.at(forces[:, 2], top, -area * pressure @ weights)
        found = find_equilibrium(body, Material("linear", young, ratio), held, motion=motion, forces=forces)
        return 4 * float((found.displacement * forces).sum())

    exact = 4 * np.pi**2 * peak**2 * (1 - ratio**2) / (15 * young)
    errors = [1 - work(cells) / exact for cells in (6, 12, 20)]
    orders = np.log(np.divide(errors[:-1], errors[1:])) / np.log([2, 20 / 12])
    assert errors[-1] < 0.01, errors
    assert (np.abs(orders - 2) < 0.3).all(), (errors, orders)


@pytest.mark.parametrize("law", [law for law in LAWS if law != "linear"])
def test_large_rotations_are_found(law: str) -> None:
    """One end turned by a quarter, in load steps: the body follows and its forces balance."""
    body = make_solid(*box((4.0, 1.0, 1.0), (8, 2, 2)), order=2)
    ends = np.isclose(body.rest[:, 0], 0) | np.isclose(body.rest[:, 0], 4)
    held = np.repeat(ends[:, None], 3, axis=1)
    motion, end = np.zeros_like(body.rest), np.isclose(body.rest[:, 0], 4)
    centred = body.rest[end] - [4, 0.5, 0.5]
    motion[end] = centred @ (np.array([[1, 0, 0], [0, 0, -1], [0, 1, 0.0]]) - np.eye(3)).T
    found = find_equilibrium(body, Material(law, 1e4, 0.3), held, motion=motion)
    assert found.material.law == law
    np.testing.assert_allclose(found.reaction.sum(axis=0), 0, atol=1e-6)
    twist = np.cross(centred + motion[end], found.reaction[end]).sum(axis=0)
    # Saint-Venant's G J per length, J = 0.1406; stretched fibres and a coarse section stiffen it.
    assert twist[0] == pytest.approx(1e4 / 2.6 * 0.1406 * np.pi / 2 / 4, rel=0.1)


@pytest.mark.parametrize("law", LAWS)
def test_derivatives_equal_finite_differences(law: str) -> None:
    body, young, ratio = block(2, seed=2), 40.0, 0.35
    forces, held = pulled(body), clamped(body)

    def rest(young: float = young, ratio: float = ratio, forces: np.ndarray = forces):
        return find_equilibrium(body, Material(law, young, ratio), held, forces=forces)

    found = rest()
    moved = found.tangents()
    for index, (more, less, step) in enumerate(
        [
            (rest(young=young + young * STEP), rest(young=young - young * STEP), young * STEP),
            (rest(ratio=ratio + STEP), rest(ratio=ratio - STEP), STEP),
        ]
    ):
        expected = (more.displacement - less.displacement) / (2 * step)
        np.testing.assert_allclose(moved[..., index], expected, atol=1e-6 * np.abs(expected).max() + 1e-9)
    weights = np.random.default_rng(0).normal(size=body.rest.shape)

    def scalar(forces: np.ndarray) -> float:
        return float((weights * rest(forces=forces).displacement).sum())

    node = int(np.flatnonzero(~held[:, 0])[5])
    push = np.zeros_like(forces)
    push[node, 1] = STEP
    expected = (scalar(forces + push) - scalar(forces - push)) / (2 * STEP)
    along = found.moved_by(push[..., None] / STEP)[..., 0]
    assert float((weights * along).sum()) == pytest.approx(expected, rel=1e-6)


def test_large_systems_are_iterated_to_the_same(monkeypatch: pytest.MonkeyPatch) -> None:
    body = block(3, seed=0)
    arguments = body, Material("corotational", 20.0, 0.3), clamped(body)
    direct = find_equilibrium(*arguments, forces=pulled(body))
    monkeypatch.setattr(linear_system, "DIRECT", 0)
    iterated = find_equilibrium(*arguments, forces=pulled(body))
    np.testing.assert_allclose(iterated.displacement, direct.displacement, atol=1e-9)
    np.testing.assert_allclose(iterated.tangents(), direct.tangents(), atol=1e-8)


def test_factors_of_a_state_close_by_save_a_factorisation(monkeypatch: pytest.MonkeyPatch) -> None:
    body = block(3, seed=0)
    arguments = body, Material("neo_hookean", 20.0, 0.3), clamped(body)
    before = find_equilibrium(*arguments, forces=pulled(body))
    before.tangents()
    alone = find_equilibrium(*arguments, forces=1.02 * pulled(body), start=before.displacement)
    made: list[int] = []
    factorise = linear_system.splu
    monkeypatch.setattr(linear_system, "splu", lambda *given, **how: made.append(1) or factorise(*given, **how))
    helped = find_equilibrium(*arguments, forces=1.02 * pulled(body), start=before.displacement, near=before.solver)
    np.testing.assert_allclose(helped.displacement, alone.displacement, atol=1e-10)
    assert not made
    # Of a state far off they are no help, and its own are made.
    far = find_equilibrium(*arguments, forces=-8 * pulled(body), near=before.solver)
    assert made
    expected = find_equilibrium(*arguments, forces=-8 * pulled(body))
    np.testing.assert_allclose(far.displacement, expected.displacement, atol=1e-9)


def test_what_has_no_answer_is_refused() -> None:
    body, material = block(1), Material("neo_hookean", 10.0, 0.3)
    held = clamped(body)
    for changed, said in (
        ({"held": np.zeros_like(held)}, "nothing is held"),
        ({"forces": np.ones(3)}, "forces has shape"),
        ({"motion": np.full(held.shape, np.nan)}, "motion holds"),
        ({"material": dataclasses.replace(material, young=np.ones(2))}, "2 Young's moduli"),
    ):
        with pytest.raises(ValueError, match=said):
            find_equilibrium(**({"solid": body, "material": material, "held": held} | changed))
    motion = np.zeros_like(body.rest)
    motion[:, 0] = np.where(np.isclose(body.rest[:, 0], 1), -1.5, 0)  # through the other end
    with pytest.raises(NoEquilibrium):
        find_equilibrium(body, material, np.ones_like(held), motion=motion)
