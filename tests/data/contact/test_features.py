"""The contact's vector: what each part says, and that it tells nothing else."""

import numpy as np
import pytest

from palpate.data.contact import features as module
from palpate.data.contact.features import FEATURES, SLOTS, contact_features, contact_spacing, contact_surroundings
from palpate.data.contact.interaction import Interaction
from palpate.physics.load import Press, held
from palpate.physics.mesh import grid_mesh
from palpate.physics.observation import Observation


@pytest.fixture
def contact() -> Interaction:
    """A contact in the middle of a flat 21×21 sheet that moves by i/1000 in frame i, 25 frames a second."""
    row, column = np.mgrid[:21, :21]
    mesh = grid_mesh(np.stack([column * 0.003, row * 0.003, np.full((21, 21), 0.5)], -1), np.ones((21, 21), bool))
    vertex = int(np.flatnonzero((mesh.pixels == (10, 10)).all(axis=1))[0])
    times = np.arange(1, 26) / 25
    along = np.arange(1, 26) / 1000
    direction = np.array([0.0, 0.0, -1.0], np.float32)
    moved = Observation.of_point(vertex, times, -along[:, None] * direction, 0.001)
    return Interaction(mesh, Press.at(vertex, direction, held(80, 200)), {"point": moved}, 0.005)


def test_parts(contact: Interaction) -> None:
    features, spacing = contact_features(contact), contact_spacing(contact.mesh, contact.vertex)
    assert features.shape == (FEATURES,)
    along, scaled, known, loaded = features[: 4 * SLOTS].reshape(4, SLOTS)
    np.testing.assert_allclose(along, np.arange(1, 26) / 1000 / spacing / 8, rtol=1e-5)
    np.testing.assert_allclose(scaled, np.arcsinh(np.arange(1, 26) / 2) / 5, rtol=1e-5)
    assert known.all()
    np.testing.assert_array_equal(loaded, module.slot_times() <= 0.4 + 1e-9)
    np.testing.assert_allclose(features[-2], np.log(0.001 / spacing) ** 2 / 4, rtol=1e-5)


def test_surroundings_of_a_flat_sheet(contact: Interaction) -> None:
    around = contact_surroundings(contact)
    shape, present, rims = around.vector[:24].reshape(8, 3), around.vector[24:32], around.vector[32:]
    assert present.all()
    np.testing.assert_allclose(shape[:, 2], 0, atol=1e-6)  # nothing along the normal
    np.testing.assert_allclose(rims, 10 / 32)  # the rim of a 21×21 sheet is ten pixels away in all directions
    lengths = np.linalg.norm(shape, axis=1) * around.spacing
    np.testing.assert_allclose(lengths[[1, 3, 4, 6]], 0.003, rtol=1e-5)


def test_only_what_was_seen_is_told(contact: Interaction) -> None:
    features = contact_features(contact.observed(np.arange(5)))
    along, _, known, loaded = features[: 4 * SLOTS].reshape(4, SLOTS)
    assert (known.sum(), loaded.sum()) == (5, 5)  # under load for 0.4 s, of which 0.2 s were seen
    assert not along[5:].any()
    assert not contact_features(contact.observed(np.arange(0)))[: 4 * SLOTS].any()


def test_a_batch_is_its_members(contact: Interaction) -> None:
    around = contact_surroundings(contact)
    along = np.stack([np.linspace(0, k, SLOTS) for k in (1, 2)])
    known, loaded = np.ones((2, SLOTS)), np.zeros((2, SLOTS))
    arguments = np.stack([around.vector] * 2), np.full(2, around.spacing), np.array([0.001, 0.002])
    both = module.join_features(along, known, loaded, *arguments)
    for index in range(2):
        one = [values[index : index + 1] for values in (along, known, loaded, *arguments)]
        np.testing.assert_array_equal(module.join_features(*one)[0], both[index])
