"""Fields over particles, spread over constraints and gathered again."""

import numpy as np
import pytest

from palpate.physics.pbd.stiffness import Stiffness, gather, spread
from tests.physics.pbd.particles import block, sheet

BODY = block((2, 1, 1))


def test_a_constraint_has_the_mean_of_its_particles():
    random = np.random.default_rng(0)
    fields = Stiffness(random.uniform(1, 2, (3, BODY.count)), random.uniform(3, 4, (3, BODY.count)), 7.0)
    found = spread(BODY, fields)
    distances, volumes, shapes = BODY.kinds
    np.testing.assert_allclose(found[:, distances], fields.distance[:, BODY.edges].mean(axis=2), rtol=1e-14)
    assert (found[:, volumes] == 7.0).all()
    members = np.split(BODY.layout.members, BODY.layout.starts[1:-1])[shapes]
    for index, shape in enumerate(members):
        np.testing.assert_allclose(found[:, shapes.start + index], fields.shape[:, shape].mean(axis=1), rtol=1e-14)


def test_gathering_is_the_transpose_of_spreading():
    random = np.random.default_rng(1)
    fields = Stiffness(*random.uniform(1, 2, (2, 2, BODY.count)), 3.0)
    slopes = random.normal(size=(2, len(BODY.layout.rest)))
    back = gather(BODY, slopes)
    paired = (back.distance * fields.distance).sum(axis=1) + (back.shape * fields.shape).sum(axis=1)
    paired += back.volume * fields.volume
    np.testing.assert_allclose(paired, (slopes * spread(BODY, fields)).sum(axis=1), rtol=1e-12)


@pytest.mark.parametrize(("fields", "sentence"), [
    (Stiffness(np.ones(5), np.ones(12)), "stiffness of distance has shape"),
    (Stiffness(np.ones(12), -np.ones(12)), "stiffness of shape holds a number that is negative"),
    (Stiffness(np.ones((2, 12)), np.ones(12)), "there are 2 fields of distance and 1 of shape"),
    (Stiffness(np.ones(12), np.ones(12), np.nan), "stiffness of volume is nan"),
])  # fmt: skip
def test_bad_fields_are_said(fields, sentence):
    with pytest.raises(ValueError, match=sentence):
        spread(sheet(3, 4), fields)
