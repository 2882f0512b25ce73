"""A sequence told by a few shapes: orthonormal, sinking, found again in what is seen, and the vector that says so."""

import numpy as np
import pytest
from scipy.ndimage import convolve

from palpate.data.contact import sequence_features as module
from palpate.data.contact.features import SLOTS, slot_times
from palpate.data.contact.interaction import Interaction
from palpate.data.contact.sequence_features import RIDGE, SHAPES, dent_shapes, motion_in_sequence, sequence_features
from palpate.data.source.camera import Camera, back_project
from palpate.physics.depth import REACH, DepthSequence, SequenceNoise
from palpate.physics.load import Press, held
from palpate.physics.mesh import grid_mesh
from palpate.physics.observation import Observation

SIDE = 2 * REACH + 1
PIXELS = SIDE * SIDE
SPACING, NOISE, WITHIN = 0.0027, 1e-3, 0.04
MIX = np.array([0.03, -0.01, 0.02, 0.004, -0.006, 0.01])


def sequence_of(amounts: np.ndarray, times: np.ndarray, hidden: np.ndarray | None = None) -> DepthSequence:
    """A depth-change sequence that holds so much of the shapes [N, SHAPES]."""
    change = (np.asarray(amounts) @ dent_shapes().T).reshape(-1, SIDE, SIDE).astype(np.float32)
    if hidden is not None:
        change[hidden] = np.nan
    return DepthSequence(np.asarray(times, np.float64), change, SequenceNoise(NOISE, 0.0), (214, 120))


def parts(vector: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Amounts and what is scaled, shape [SLOTS, SHAPES] each, and the two flags."""
    assert (vector.dtype, vector.shape) == (np.float32, (module.SEQUENCE_FEATURES,))
    count = SLOTS * SHAPES
    found = vector[:count].reshape(SLOTS, SHAPES), vector[count : 2 * count].reshape(SLOTS, SHAPES)
    return *found, vector[2 * count :]


def test_shapes_are_orthonormal_and_symmetric() -> None:
    shapes = dent_shapes()
    assert shapes.shape == (PIXELS, SHAPES)
    np.testing.assert_allclose(shapes.T @ shapes, np.eye(SHAPES), atol=1e-12)
    pictures = shapes.T.reshape(SHAPES, SIDE, SIDE)
    # The springs' diagonals run one way: turned by half, and mirrored on them, a sheet is the same.
    np.testing.assert_allclose(pictures, pictures[:, ::-1, ::-1], atol=1e-9)
    np.testing.assert_allclose(pictures, pictures.swapaxes(1, 2), atol=1e-9)
    assert (pictures[:, REACH, REACH] > 0).any()
    assert (shapes[:, 0] >= 0).all()
    assert shapes[:, 0].argmax() == PIXELS // 2


@pytest.mark.parametrize("foundation", module.FOUNDATIONS)
def test_a_static_dent_lies_in_the_shapes(foundation: float) -> None:
    """The answer of a sheet of springs on a foundation, relaxed node by node."""
    side = 2 * (REACH + module.MARGIN) + 1
    press, sunk, neighbours = np.zeros((side, side)), np.zeros((side, side)), [[1, 1, 0], [1, 0, 1], [0, 1, 1]]
    weight = convolve(np.ones((side, side)), neighbours, mode="constant") + foundation
    press[side // 2, side // 2] = 1
    for _ in range(6000):
        sunk = (press + convolve(sunk, neighbours, mode="constant")) / weight
    seen = sunk[module.MARGIN : -module.MARGIN, module.MARGIN : -module.MARGIN].ravel()
    shapes = dent_shapes()
    np.testing.assert_allclose(shapes @ (shapes.T @ seen), seen, atol=1e-6 * seen.max())


def test_hidden_pixels_hardly_change_the_amounts() -> None:
    generator = np.random.default_rng(0)
    shapes = dent_shapes()
    change = np.repeat((MIX @ shapes.T)[None], 8, axis=0)
    hidden = generator.random(change.shape) < 1 / 3
    hidden[:, PIXELS // 2] = False
    change[hidden] = np.nan
    amounts, factors = module.shape_amounts(change)
    np.testing.assert_allclose(amounts, np.broadcast_to(MIX, amounts.shape), atol=0.01 * np.abs(MIX).max())
    for row, found, factor in zip(change, amounts, factors, strict=True):
        kept = shapes[np.isfinite(row)]
        # A ridge is as good as six more pixels that show nothing.
        more = np.concatenate([kept, np.sqrt(RIDGE) * np.eye(SHAPES)])
        expected = np.linalg.lstsq(more, np.concatenate([row[np.isfinite(row)], np.zeros(SHAPES)]), rcond=None)[0]
        np.testing.assert_allclose(found, expected, rtol=1e-8)
        np.testing.assert_allclose(factor @ factor.T, np.linalg.inv(more.T @ more), rtol=1e-8, atol=1e-10)
        np.testing.assert_array_equal(factor, np.tril(factor))


def test_without_a_sequence_the_vector_is_zero_and_says_so() -> None:
    times = slot_times()
    hidden = np.ones((SLOTS, SIDE, SIDE), bool)
    unseen = sequence_of(np.tile(MIX, (SLOTS, 1)), times, hidden)
    empty = sequence_of(np.zeros((0, SHAPES)), np.zeros(0))
    for sequence in (None, empty, unseen):
        vector = sequence_features(sequence, SPACING, NOISE, WITHIN)
        np.testing.assert_array_equal(vector[:-2], 0)
        np.testing.assert_allclose(vector[-2:], [WITHIN / times[0], 0])


def test_a_sequence_at_the_slots_is_told_as_it_is() -> None:
    times = slot_times()
    mixes = np.linspace(0, 1, SLOTS)[:, None] * MIX
    amounts, scaled, flags = parts(sequence_features(sequence_of(mixes, times), SPACING, NOISE, 0.0))
    found = mixes / (1 + RIDGE)
    np.testing.assert_allclose(amounts, found / SPACING / module.LARGE, rtol=1e-5, atol=1e-8)
    np.testing.assert_allclose(scaled, np.arcsinh(found / (2 * NOISE)) / 5, rtol=1e-5, atol=1e-7)
    np.testing.assert_array_equal(flags, [0, 1])


def test_between_frames_amounts_go_on_evenly_and_end_with_the_sequence() -> None:
    """Seen at 12.5 Hz for 0.4 s, one of its frames behind the tool."""
    times = 0.08 * np.arange(1, 6)
    mixes = np.array([1.0, 3.0, 100.0, 2.0, 1.0])[:, None] * MIX
    hidden = np.zeros((5, SIDE, SIDE), bool)
    hidden[2].reshape(-1)[: int((1 - 0.4) * PIXELS) + 1] = True
    amounts, _, flags = parts(sequence_features(sequence_of(mixes, times, hidden), SPACING, NOISE, WITHIN))
    slots = slot_times()
    size = np.interp(slots, [0, 0.08, 0.16, 0.32, 0.4], [0, 1, 3, 2, 1]) * (slots < 0.4 + 1e-6)
    found = size[:, None] * MIX / (1 + RIDGE)
    np.testing.assert_allclose(amounts, found / SPACING / module.LARGE, rtol=1e-5, atol=1e-8)
    assert (amounts[9] != 0).all()
    assert (amounts[10:] == 0).all()
    np.testing.assert_allclose(flags, [WITHIN / slots[0], 1])


def test_joined_vectors_are_those_of_each() -> None:
    generator = np.random.default_rng(2)
    times, spacing = slot_times(), np.array([0.002, 0.003, 0.004])
    noise, within = np.array([1e-3, 2e-3, 5e-4]), np.array([0.0, 0.04, 0.02])
    mixes = generator.normal(0, 0.02, (3, SLOTS, SHAPES)).astype(np.float32)
    told = np.array([True, False, True])
    joined = module.join_sequence_features(mixes / (1 + RIDGE), spacing, noise, within, told)
    for index in range(3):
        sequence = sequence_of(mixes[index], times) if told[index] else None
        alone = sequence_features(sequence, spacing[index], noise[index], within[index])
        np.testing.assert_allclose(joined[index], alone, rtol=2e-5, atol=1e-6)
    assert (joined.dtype, joined.shape) == (np.float32, (3, module.SEQUENCE_FEATURES))


def followed(size: tuple[int, int]) -> Interaction:
    """A point of a mesh of 8x8 pixels, followed over four frames; its sequence has three, the last without its
    pixel."""
    camera = Camera(fx=10.0, fy=10.0, cx=3.5, cy=3.5, width=8, height=8)
    mesh = grid_mesh(back_project(np.full((8, 8), 0.5), camera), np.ones((8, 8), bool), max_edge=1.0)
    times = np.array([0.04, 0.08, 0.12, 0.16])
    observed = Observation.of_point(45, times, 0.001 * np.arange(12).reshape(4, 3), NOISE)
    change = np.zeros((3, SIDE, SIDE), np.float32)
    change[:, REACH, REACH] = 0.01, 0.02, np.nan
    sequence = DepthSequence(times[[0, 2, 3]], change, SequenceNoise(NOISE, 0.0), size)
    return Interaction(mesh, Press.at(45, np.array([0.0, 0.0, 1.0]), held(10, 40)), {"point": observed}, 0.005).having(
        depth=sequence
    )


def test_in_a_finer_picture_the_contact_moves_as_its_pixel_shows() -> None:
    """Along its ray; where the pixel or the frame is missing it moves as it was followed."""
    contact = followed((16, 16))
    ray = np.array([(45 % 8 - 3.5) / 10, (45 // 8 - 3.5) / 10, 1.0])
    expected = np.stack([0.01 * ray, contact.moved[1], 0.02 * ray, contact.moved[3]])
    np.testing.assert_allclose(motion_in_sequence(contact), expected, rtol=1e-6)


@pytest.mark.parametrize("size", [(8, 8), (4, 8)])
def test_in_another_picture_the_contact_moves_as_it_was_followed(size: tuple[int, int]) -> None:
    contact = followed(size)
    np.testing.assert_array_equal(motion_in_sequence(contact), contact.moved)
    np.testing.assert_array_equal(motion_in_sequence(contact.having(depth=None)), contact.moved)
