"""What a batch tells of a contact: what was known at the sample's frame, and nothing of later ones."""

import functools
from dataclasses import replace

import numpy as np
import pytest
import torch

from palpate.data.clip import prepare
from palpate.data.contact.features import FEATURES
from palpate.data.contact.interaction import Interaction
from palpate.data.contact.sequence_features import SEQUENCE_FEATURES, dent_features
from palpate.data.synthetic.contacts import draw_contacts
from palpate.data.synthetic.settings import SceneSettings
from palpate.data.training.batches import SampleDataset, collate, dent_of
from palpate.data.training.samples import SampleSettings, list_frames, make_sample
from palpate.estimators.direct.problem import dent_problem
from palpate.models.losses import posterior_physics_loss
from palpate.physics.depth import REACH, SequenceNoise
from palpate.physics.mechanics import RECOMMENDED, Mechanics
from palpate.physics.msd.batch import Direction, PairBatch
from tests.data.clips import GRID, SETTINGS, write_clip

SMOOTH = replace(GRID, smoothing=4.0)
TOLD = SampleSettings(window=2, observation="trajectory", onset_within=9, geometry=SMOOTH)
MECHANICS = Mechanics(scheme="dkd", window_error=1e-4)
PIXELS = (2 * REACH + 1) ** 2


@pytest.fixture(scope="module")
def written(tmp_path_factory):
    """A folder with a clip in it."""
    return write_clip(tmp_path_factory.mktemp("batches") / "clip").parent


@pytest.fixture
def clip(written):
    """Contact in frames 3 to 7 of 12, 40 ms apart, its noise known; read anew from the cache."""
    return prepare(written / "clip", replace(SETTINGS, geometry=SMOOTH), written / "cache")


def batch_of(clip, frames: list[int], settings: SampleSettings = TOLD) -> PairBatch:
    dataset = SampleDataset([clip], [(0, frame) for frame in frames], settings)
    return collate([dataset[index] for index in range(len(frames))])


def told(one: Direction) -> list[torch.Tensor]:
    [load] = one.known_loads
    parts = map(torch.from_numpy, (load.direction, load.factor, load.vertices))
    return [one.contact_features, *parts, torch.from_numpy(np.nan_to_num(one.dents[0].observed))]


def test_loads_are_those_of_the_contact_cut_off_at_the_frame(clip):
    frames = [3, 4, 6, 10]
    batch = batch_of(clip, frames)
    assert [load.factor.sum() for load in batch.a.known_loads] == [
        0,
        8,
        24,
        40,
    ]  # in contact in frames 3 to 7, out in 8
    assert batch.a.observation.weight.sum(dim=1).tolist() == [8, 8, 8, 8]


@pytest.mark.parametrize("frame", [3, 4, 6])
def test_nothing_that_is_told_comes_from_later_frames(clip, frame: int):
    """Another future of the same contact: its tissue goes elsewhere and the contact ends at once."""
    along = replace(TOLD, geometry=replace(SMOOTH, force_direction="displacement"))
    known = batch_of(clip, [frame], along)
    clip.track_position, clip.contact = clip.track_position.copy(), clip.contact.copy()
    clip.track_position[frame + 1 :] += (0.1, 0.0, 0.05)
    clip.contact[frame + 1 :] = False
    now = batch_of(clip, [frame], along)
    assert not torch.equal(now.a.observation.displacement, known.a.observation.displacement)
    for one, other in ((now.a, known.a), (now.b, known.b)):
        for ours, theirs in zip(told(one), told(other), strict=True):
            assert torch.equal(ours, theirs)


def test_without_a_known_noise_or_a_trajectory_nothing_is_told(clip, tmp_path):
    plain = prepare(write_clip(tmp_path / "plain"), SETTINGS, tmp_path / "cache")
    for prepared, settings in ((plain, replace(TOLD, geometry=GRID)), (clip, SampleSettings(geometry=SMOOTH))):
        batch = batch_of(prepared, [3, 4], settings)
        assert all((one.contact_features, one.known_loads, one.dents) == (None, (), ()) for one in (batch.a, batch.b))
        assert make_sample(prepared, 3, settings).known is None


def test_frames_up_to_a_second_after_the_onset_become_samples(clip):
    assert list_frames(clip, replace(TOLD, onset_within=None))[0] == [3, 4]
    expected = [3, 4, 5, 6, 7, 8], {"no_tool": 3, "onset too far back": 3}
    assert list_frames(clip, replace(TOLD, onset_within=6)) == expected
    assert make_sample(clip, 8, TOLD).known.observation.steps(0.005).tolist() == [7, 15, 23, 31, 39]


def test_dents_are_told_and_joined(clip) -> None:
    samples = [make_sample(clip, frame, TOLD) for frame in (4, 6)]
    batch = collate(samples)
    for row, sample in enumerate(samples):
        assert sample.known.sequence is not None
        expected = dent_features(sample.known, within=0.0)
        for one in (batch.a, batch.b):
            assert one.contact_features.shape == (2, FEATURES + SEQUENCE_FEATURES)
            np.testing.assert_array_equal(one.contact_features[row].numpy(), expected)
    assert [dent.observed.shape for dent in batch.a.dents] == [(1, PIXELS), (3, PIXELS)]


@pytest.mark.parametrize("fine", [False, True])
def test_training_and_the_direct_fit_have_one_likelihood(fine: bool) -> None:
    """At one θ, of noise that is independent but for the rest surface's: the same pull and the same information."""
    contact, theta = contact_of(fine)
    drawn = np.random.default_rng(0).normal(0, 1e-3, contact.sequence.change.shape).astype(np.float32)
    sequence = replace(contact.sequence, change=contact.sequence.change + drawn, noise=SequenceNoise(1e-3, 0.0))
    contact = contact.having(depth=sequence, point=contact.observation.moved(contact.moved, 1e-3))
    logs = np.log(np.abs(theta)) + np.array([0.1, -0.05, 0.1])
    problem = dent_problem(contact, MECHANICS)
    problem.look(logs)
    jacobian = problem.jacobian(logs)
    mean, box = torch.from_numpy(logs)[None], (torch.from_numpy(ends) for ends in RECOMMENDED.log_box)
    what = [contact.mesh], [contact.load], [dent_of(contact)], MECHANICS, tuple(box)
    _, information = posterior_physics_loss(mean.requires_grad_(), torch.eye(3, dtype=mean.dtype)[None], *what)
    np.testing.assert_allclose(information[0].numpy(), jacobian.T @ jacobian, rtol=1e-5)


def test_without_a_sequence_the_middle_pixel_shows_the_contacts_own_motion() -> None:
    contact, _ = contact_of(False)
    alone = contact.having(depth=None, point=contact.observation.moved(contact.moved, 1e-3))
    dent = dent_of(alone)
    middle = PIXELS // 2
    assert np.flatnonzero(dent.seen.any(axis=0)).tolist() == [middle]
    shown = contact.sequence.change[-1].ravel()[middle]
    assert dent.observed[-1, middle] == pytest.approx(shown, abs=1e-6)
    assert dent.noise == SequenceNoise(1e-3, 0.0)


@functools.cache
def contact_of(fine: bool) -> tuple[Interaction, np.ndarray]:
    """A simulated contact, exactly seen in a picture of the grid's size or a larger one, and its θ."""
    settings = SceneSettings(width=214, height=120, regime="critical")
    found = (draw_contacts(settings, seed, 1, MECHANICS.time_step, sequence=True) for seed in range(30))
    drawn = next(each[0] for each in found if each and (each[0].interaction.sequence.size == (854, 480)) == fine)
    return drawn.interaction, drawn.theta


def test_the_frame_of_the_onset_tells_nothing(clip):
    """No instant is observed yet, so θ isn't pulled anywhere, and the loss is a number."""
    one = batch_of(clip, [3]).a
    box = torch.tensor(RECOMMENDED.log_box)
    mean, factor = box.mean(dim=0)[None].double().requires_grad_(), 0.1 * torch.eye(3).double()[None]
    given = one.meshes, one.known_loads, one.dents, Mechanics(), tuple(box)
    loss, information = posterior_physics_loss(mean, factor, *given)
    assert torch.isfinite(loss)
    assert not information.any()
