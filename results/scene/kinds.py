"""The scene of a run of contact, and what each kind's own simulator makes of a scene.

press      a sheet of springs under a force
slab       finite elements beneath tissue, under a force
palpation  a palpated body of finite elements, at rest under a force
field      particles of the online estimator, as they were known last
"""

from typing import Any

import numpy as np

from palpate.data.contact.interaction import Interaction
from palpate.estimators.direct.estimator import fitted_press
from palpate.estimators.direct.slab_motion import DENSITY, LAW, PATCH, POISSON, TOLERANCE
from palpate.estimators.estimate import NINETY, Estimate, NoEstimate
from palpate.estimators.online.particle_field import FieldEstimate
from palpate.estimators.palpation.material_fit import MaterialFit
from palpate.estimators.records import InteractionEstimate
from palpate.physics import fem
from palpate.physics.fem.curved import bent
from palpate.physics.fem.solid import EDGES, EIGHTHS, Solid, outer_faces
from palpate.physics.load import Press
from palpate.physics.mechanics import PARAMETERS, SCHEMES, Mechanics
from palpate.physics.mesh import Mesh
from palpate.physics.msd.reference import free_vertices
from palpate.physics.msd.simulation import simulate
from palpate.physics.pbd import simulation as pbd
from palpate.physics.pbd.body import make_body
from palpate.physics.pbd.stiffness import Stiffness
from palpate.results.scene.scene import KINDS, Scene, make_scene

WIDEST = 50.0
"""Standard deviation of a logarithm above which nothing is known."""


def scene_of(run: InteractionEstimate) -> Scene:
    """That of a run of contact, by what its verdict is given by.

    Raises:
        NoEstimate: what its simulator needs is not determined.
    """
    found, contact = run.estimate, run.interaction
    if run.field is not None:
        return _field(run.field)
    if run.grip is not None and run.main_estimate is run.grip:
        raise NoEstimate("How firmly the pulled tissue is attached is not determined.")
    if found is not None and contact is not None and found.slab is not None:
        return _slab(found, contact)
    if found is None or contact is None or run.mechanics is None:
        raise NoEstimate("No sheet of springs was fitted.")
    return _press(found, contact, run.mechanics)


def simulated(scene: Scene) -> np.ndarray:
    """Displacement of every vertex from rest after every time step or frame, shape [T, N, 3], in the scene's unit.

    Raises:
        NoEquilibrium: finite elements can't bear the load, as with other numbers than were estimated.
    """
    moves = _pressed, _dented, _rested, _driven
    return dict(zip(KINDS, moves, strict=True))[scene.kind](scene)


def _theta(found: Estimate) -> dict[str, Any]:
    """Parts of an estimate: stiffness, damping and signed force, each with both ends of its 90 % interval.

    Raises:
        NoEstimate: they are not all determined.
    """
    if not {*PARAMETERS} <= {*found.determined}:
        raise NoEstimate("Stiffness, damping and force are not all determined.")
    numbers, theta = found.numbers(), np.asarray(found.theta, np.float64)
    ends = np.array([[numbers[f"{name}_{end}"] for end in ("low", "high")] for name in PARAMETERS])
    return dict(zip(PARAMETERS, np.column_stack([theta, np.sort(np.sign(theta)[:, None] * ends)]), strict=True))


def _load(press: Press, force: float, vertices: int) -> dict[str, Any]:
    """Parts of a load with that force, on a body of so many vertices."""
    load = np.zeros((vertices, 3))
    np.add.at(load, press.vertices, force * np.outer(press.weights, press.direction))
    return {"load": load} | {f"load_{name}": values for name, values in vars(press).items()}


def _press(found: Estimate, contact: Interaction, mechanics: Mechanics) -> Scene:
    mesh, press = contact.mesh, fitted_press(contact, found, mechanics.time_step, mechanics.steps)
    values = _theta(found) | _load(press, float(found.theta[2]), len(mesh.vertices))
    values |= {"points": mesh.vertices, "held": ~free_vertices(mesh, press), "by_light": found.by_light}
    values |= {name: getattr(mesh, name) for name in ("triangles", "springs", "pixels", "grid_shape")}
    return make_scene("press", **values | vars(mechanics) | {"scheme": SCHEMES.index(mechanics.scheme)})


def pressed(scene: Scene) -> tuple[np.ndarray, Mesh, Press, Mechanics]:
    """What `palpate.simulate` takes of a press: θ, shape [3], mesh, load and constants."""
    parts, press = scene.parts, scene.press
    sheet = (parts[name] for name in ("points", "triangles", "springs"))
    mesh = Mesh(*sheet, parts["held"].ravel() > 0, parts["pixels"], tuple(parts["grid_shape"][0].tolist()))
    scheme, loaded = SCHEMES[scene.number("scheme")], int(np.count_nonzero(press.factor))
    mechanics = Mechanics(scene.number("mass"), scene.number("time_step"), press.steps, loaded, scheme)
    return np.array([scene.number(name) for name in PARAMETERS]), mesh, press, mechanics


def _pressed(scene: Scene) -> np.ndarray:
    return simulate(*pressed(scene), watch=np.arange(len(scene.parts["points"])), dtype=np.float64)


def _slab(found: Estimate, contact: Interaction) -> Scene:
    motion, fine, force = found.slab, found.slab.fine, float(found.theta[2])
    shares = fine.patch(PATCH, motion.place)
    linear, factor = np.zeros(len(shares)), fitted_press(contact, found, motion.step, motion.longest).factor
    linear[: len(motion.slab.solid.rest)] = motion.slab.patch(PATCH, motion.place)
    nodes = np.flatnonzero(shares)
    press = Press(nodes, shares[nodes], np.asarray(contact.direction, np.float64), factor)
    values = _theta(found) | _load(press, force, len(shares)) | _shape(fine.solid, fine.held, LAW)
    values |= {"load_linear": linear, "poisson": POISSON, "density": DENSITY, "time_step": motion.step}
    values["damping"] = values["damping"] / DENSITY
    return make_scene("slab", **values)


def palpation_scene(found: MaterialFit, number: int) -> Scene:
    """That of a palpation, counted from 0, of a fit that determines E."""
    rest, half = found.rests[number], NINETY * np.array([0.0, -1.0, 1.0])
    values = {"stiffness": found.young * np.exp(half * found.young_sd), "load": rest.energy.forces}
    values |= _shape(rest.energy.solid, rest.held, rest.material.law)
    return make_scene("palpation", poisson=found.poisson + half * found.poisson_sd, **values)


def _shape(solid: Solid, held: np.ndarray, law: str) -> dict[str, Any]:
    values = {"points": solid.rest, "elements": solid.elements, "held": held.all(axis=1), "law": fem.LAWS.index(law)}
    return values | {"triangles": outer_faces(solid.elements[:, EIGHTHS].reshape(-1, 4))}


def _solids(scene: Scene) -> list[Solid]:
    """Of linear elements, whose nodes come first, and of quadratic ones."""
    points, elements = scene.parts["points"].astype(np.float64), scene.parts["elements"]
    linear, straight = (
        fem.make_solid(points[: elements[:, 4:].min()], elements[:, :4], order=order) for order in (1, 2)
    )
    return [linear, bent(straight, points - straight.rest)]


def _dented(scene: Scene) -> np.ndarray:
    """As `SlabMotion` has it: linear elements by the law, and what quadratic ones change in small motions."""
    parts, press, elements, (linear, quadratic) = scene.parts, scene.press, scene.parts["elements"], _solids(scene)
    inertia = fem.Inertia(scene.number("density"), scene.number("damping"))
    step, how = scene.number("time_step"), {"force": scene.number("force"), "tolerance": TOLERANCE}

    def followed(solid: Solid, law: str, load: Press) -> np.ndarray:
        held = np.repeat(parts["held"][: len(solid.rest)] > 0, 3, axis=1)
        material = fem.Material(law, scene.number("stiffness"), scene.number("poisson"))
        return fem.simulate(solid, material, held, load, step, inertia=inertia, **how).displacement[1:]

    nodes = parts["load_linear"].nonzero()[0]
    corners = Press(nodes, parts["load_linear"][nodes, 0], press.direction, press.factor)
    change = followed(linear, fem.LAWS[scene.number("law")], corners) - followed(linear, "linear", corners)
    found = followed(quadratic, "linear", press)
    found[:, : change.shape[1]] += change
    middles, first = np.unique(elements[:, 4:], return_index=True)
    found[:, middles] += change[:, elements[:, EDGES].reshape(-1, 2)[first]].mean(axis=2)
    return found


def _rested(scene: Scene) -> np.ndarray:
    law, held = fem.LAWS[scene.number("law")], np.repeat(scene.parts["held"] > 0, 3, axis=1)
    material = fem.Material(law, scene.number("stiffness"), scene.number("poisson"))
    return fem.find_equilibrium(_solids(scene)[1], material, held, forces=scene.parts["load"]).displacement[None]


def _field(found: FieldEstimate) -> Scene:
    if not found.explained:
        raise NoEstimate("Tissue simulated under the instrument alone does not explain the motion.")
    last, session, way = found.last, found.driven.session, np.stack(found.driven.past)
    body, gripped = found.driven.surface.body, found.driven.surface.gripped
    values = {"points": body.rest, "triangles": body.faces, "springs": body.edges, "tetrahedra": body.tetrahedra}
    ends = np.minimum([last.distance_log_sd, last.shape_log_sd], WIDEST)[..., None] * NINETY * np.array([0, -1, 1])
    values |= zip(("stiffness", "bending"), np.array(session.fields[:2])[..., None] * np.exp(ends), strict=True)
    values |= {"held": body.pinned, "known": np.column_stack([last.known, last.shape_known])}
    values |= {"grip_vertices": gripped, "grip_path": way - body.rest[gripped], "times": np.arange(1, len(way) + 1)}
    return make_scene("field", incompressible=session.fields.volume, **values | vars(session.objective.stepping))


def _driven(scene: Scene) -> np.ndarray:
    parts = scene.parts
    body = make_body(parts["points"], parts["triangles"], parts["tetrahedra"], pinned=parts["held"].ravel() > 0)
    stepping = pbd.Stepping(*(scene.number(name) for name in ("time_step", "iterations", "foundation")))
    fields = Stiffness(parts["stiffness"][:, 0], parts["bending"][:, 0], scene.number("incompressible"))
    return pbd.simulate(body, fields, scene.grip, stepping).positions[0, 1:] - body.rest
