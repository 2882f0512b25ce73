"""Simulated pulls: who moves as the gripper does, who not at all, and where a stiff part shows."""

import numpy as np
import pytest
from scipy.stats import spearmanr

from benchmarks.online.sequences import BLOCK, FINE, FINE_CELLS, KEYPOINTS, NOISE, SEQUENCES, SIDE, STIFF, Pull

FRAMES, PARTICLES, POINTS = 8, 80, 200


@pytest.fixture(scope="module", params=["thin-shell-1", "volume-2"])
def pull(request: pytest.FixtureRequest) -> Pull:
    return SEQUENCES[request.param].pull(PARTICLES, POINTS, FRAMES)


def test_the_truth_moves_as_it_is_held(pull: Pull) -> None:
    body = pull.body
    # To a hundredth of an edge: between held nodes of the truth's mesh and others it is interpolated.
    np.testing.assert_allclose(pull.truth[:, pull.gripped], pull.places, atol=1.5e-4)
    np.testing.assert_allclose(
        pull.truth[:, body.pinned], np.broadcast_to(body.rest[body.pinned], (FRAMES, body.pinned.sum(), 3)), atol=1e-12
    )
    assert len(pull.gripped) > 0
    moved = np.linalg.norm(pull.truth[-1] - body.rest, axis=1)
    free = ~body.pinned
    free[pull.gripped] = False
    assert 0 < moved[free].max() < 1.5 * moved[pull.gripped].max()  # a block turns, too
    assert pull.moving().any()
    assert not pull.moving()[~free].any()


def test_its_mesh_is_another(pull: Pull) -> None:
    assert pull.body.count not in (FINE**2, np.prod(np.array(FINE_CELLS) + 1))
    assert 0.6 * PARTICLES < pull.body.count < 1.6 * PARTICLES
    assert set(np.unique(pull.stiffness)) == {1.0, STIFF}


def test_what_is_seen_is_the_truth_and_noise(pull: Pull) -> None:
    assert pull.clouds.shape == (FRAMES, POINTS, 3)
    np.testing.assert_allclose(pull.shares @ pull.body.rest, pull.points[0], atol=1e-12)
    noise = pull.tracks - pull.points[1:]
    assert noise.std() == pytest.approx(NOISE, rel=0.1)
    assert len(set(pull.keypoints.tolist())) == KEYPOINTS
    moved = np.linalg.norm(pull.points[-1] - pull.points[0], axis=1)
    assert moved[pull.keypoints].min() >= 0.9 * np.median(moved)
    assert (pull.body.rest[pull.visible, 2] == pull.body.rest[:, 2].max()).all()


def test_a_stiff_part_is_stretched_less() -> None:
    """Along the pull one force goes through both halves, so that strains go as 1 over stiffness."""
    pull = SEQUENCES["thin-shell-1"].pull(PARTICLES, POINTS, 20)
    first, second = pull.body.edges.T
    rest = pull.body.rest
    inner = np.abs(rest[first, 1] - rest[second, 1]) < 1e-9
    lengths = np.linalg.norm(pull.truth[-1, first] - pull.truth[-1, second], axis=1)
    strain = lengths / pull.body.layout.rest[pull.body.kinds[0]] - 1
    middle = rest[first, 0] / 2 + rest[second, 0] / 2
    stiff, soft = (strain[inner & part].mean() for part in (middle < 0.05, (middle > 0.065) & (middle < 0.1)))
    assert 0 < 1.5 * stiff < soft


@pytest.mark.parametrize("name", SEQUENCES)
def test_the_best_of_fields_could_be_seen_to_be_good(name: str) -> None:
    """Distinct numbers correlate with a truth of two values, one on a share p, by √(3p(1 - p)) at most."""
    size = BLOCK[:2] if SEQUENCES[name].block else (SIDE, SIDE)
    places = np.random.default_rng(0).uniform(0, 1, (4000, 3)) * (*size, 0.0)
    stiff = SEQUENCES[name].stiff(places)
    best = spearmanr(stiff + 1e-6 * np.arange(4000), stiff).statistic
    assert best == pytest.approx(np.sqrt(3 * stiff.mean() * (1 - stiff.mean())), abs=1e-3)
    assert best > 0.8
