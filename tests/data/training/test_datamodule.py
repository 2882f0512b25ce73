"""Batches, splits and order."""

import json
import warnings
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import torch

from palpate.data.contact.geometry import GeometrySettings
from palpate.data.source.layout import InputError
from palpate.data.training.datamodule import ClipDataModule
from palpate.data.training.samples import SampleSettings
from palpate.data.training.splits import LoadingSettings
from palpate.physics.mechanics import Bounds, UnstableConfiguration
from palpate.physics.msd import rollout
from palpate.physics.msd.likelihoods import displacement_error
from tests.data.clips import GRID, write_clip


def made(folder: Path, loading: dict | None = None, geometry: GeometrySettings = GRID, **options) -> ClipDataModule:
    """Data module over `folder`/data; options are its own or its samples'."""
    own = {name: options.pop(name) for name in ("bounds", "depth") if name in options}
    own |= {"cache": str(folder / "cache"), "loading": LoadingSettings(**loading or {}), "geometry": geometry}
    return ClipDataModule(str(folder / "data"), samples=SampleSettings(geometry=geometry, **options), **own)


def module(folder: Path, loading: dict | None = None, **samples) -> ClipDataModule:
    """Data module over `folder`/data, set up."""
    data = made(folder, loading, **samples)
    data.prepare_data()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        data.setup("fit")
    return data


@pytest.fixture(scope="module")
def one_clip(tmp_path_factory):
    """Ten pairs of one video."""
    folder = tmp_path_factory.mktemp("one")
    write_clip(folder / "data" / "video01" / "video01_00000", contact=tuple(range(2, 13)), frames=14)
    return folder


@pytest.fixture(scope="module")
def four_videos(tmp_path_factory):
    """Four pairs of each of four videos."""
    folder = tmp_path_factory.mktemp("four")
    for number in range(1, 5):
        write_clip(folder / "data" / f"video{number:02d}" / f"video{number:02d}_00000")
    return folder


def order(loader) -> list[tuple[str, int]]:
    return [(clip, int(frame)) for batch in loader for clip, frame in zip(batch.clips, batch.frames, strict=True)]


def test_a_batch_holds_what_the_training_step_needs(one_clip):
    data = module(one_clip, window=3)
    batch = next(iter(data.train_dataloader()))
    for one in (batch.a, batch.b):
        window, loads, observation = one.window, one.loads, one.observation
        assert (window.shape, window.dtype) == ((2, 3, 48, 64), torch.float32)
        assert [np.linalg.norm(load.direction) for load in loads] == pytest.approx([1, 1], abs=1e-5)
        assert observation.steps.tolist() == [[199], [199]]
        theta = torch.tensor([[0.5, 0.1, -0.1]]).repeat(2, 1)
        trajectory = rollout(theta, one.meshes, loads, data.mechanics)
        assert torch.isfinite(displacement_error(trajectory, observation)).all()


def test_trajectories_of_differing_length_are_padded_with_weight_zero(tmp_path):
    write_clip(tmp_path / "data" / "video01" / "video01_00000", frames=8)
    write_clip(tmp_path / "data" / "video01" / "video01_00080", frames=12)
    data = module(tmp_path, {"batch_size": 20, "fractions": (1.0, 0.0, 0.0)}, observation="trajectory", window=4)
    batch = next(iter(data.train_dataloader()))
    lengths = dict(zip(batch.clips, batch.a.observation.weight.sum(dim=1).tolist(), strict=True))
    assert (lengths, batch.a.observation.displacement.shape[1]) == ({"video01_00000": 4, "video01_00080": 8}, 8)
    assert torch.equal(batch.a.observation.displacement, batch.b.observation.displacement)


def test_few_videos_are_split_in_time_with_a_warning(one_clip):
    data = made(one_clip)
    with pytest.warns(UserWarning, match="split in time"):
        data.setup("fit")
    frames = {split: [frame for _, frame in places] for split, places in data.places.items()}
    assert frames == {"train": [2, 3, 4, 5, 6, 7, 8], "val": [9, 10], "test": [11]}
    assert data.left_out == {"no_tool": 3, "next frame not in contact": 1}
    assert [said in data.summary() for said in ("7 train, 2 val, 1 test", "3 no_tool")] == [True, True]


def test_three_or_more_videos_share_no_video(four_videos):
    data = module(four_videos)
    videos = {split: {clip for clip, _ in places} for split, places in data.places.items()}
    assert sum(len(found) for found in videos.values()) == 4
    assert all(videos.values())
    assert sum(len(places) for places in data.places.values()) == 16


def test_order_depends_on_seed_and_epoch_only(four_videos):
    first, second, other = (module(four_videos, {"seed": seed}).train_dataloader() for seed in (0, 0, 1))
    for loader in (first, second, other):
        loader.sampler.set_epoch(5)
    fifth = order(first)
    assert order(other) != fifth == order(second)
    first.sampler.set_epoch(6)
    assert order(first) != fifth
    assert sorted(order(first)) == sorted(fifth)


def test_processes_share_the_test_s_samples_without_repeating_one(four_videos):
    data = module(four_videos, {"batch_size": 1})
    whole, parts = order(data.test_dataloader()), []
    for rank in range(3):
        data.trainer = SimpleNamespace(world_size=3, global_rank=rank)
        parts.append(order(data.test_dataloader()))
    assert [len(part) for part in parts] == [2, 1, 1]  # as test's records are joined: dealt out in turn
    assert [parts[index % 3][index // 3] for index in range(len(whole))] == whole
    data.trainer = SimpleNamespace(world_size=9, global_rank=0)
    with pytest.raises(InputError, match=r"data has 4 samples in split test for 9 processes; lower trainer\.devices"):
        data.test_dataloader()


def test_interactions_and_metadata(one_clip):
    data = module(one_clip, window=2)
    found, (clip,) = data.interactions("train", 3), data.clips
    for interaction, frame in zip(found, (2, 5, 8), strict=True):
        np.testing.assert_array_equal(interaction.moved, np.float32(clip.displacement[frame : frame + 1]))
        np.testing.assert_array_equal(interaction.mesh.vertices, clip.mesh(frame).vertices)
        assert interaction.vertex == clip.vertex[frame]
        assert interaction.load_seconds == pytest.approx(data.mechanics.load_steps * data.mechanics.time_step)
    assert len(data.interactions("test")) == 1
    text = json.dumps(data.metadata())
    assert json.loads(text)["geometry"]["height"] == 48
    assert json.loads(text)["classes"] == {"tool": ["grasper"], "tissue": ["gallbladder"], "tolerance": 5}
    assert str(one_clip) not in text


def test_an_unstable_box_is_refused_with_the_numbers(one_clip):
    data = made(one_clip, bounds=Bounds(stiffness=(0.0, 100.0)))
    with pytest.raises(UnstableConfiguration, match="k_s = 100"), pytest.warns(UserWarning, match="in time"):
        data.setup("fit")


def test_without_contact_or_onset_one_sentence_says_what_to_do(tmp_path):
    write_clip(tmp_path / "data" / "video01_00000", contact=(), frames=4)
    with pytest.raises(InputError, match=r"no frame in contact \(4 no_tool\); check"):
        module(tmp_path)
    write_clip(tmp_path / "more" / "data" / "video01_00000", contact=(0, 1), frames=4)
    with pytest.raises(InputError, match=r"2 onset not observed.*observation final"):
        module(tmp_path / "more", observation="trajectory", window=8)


def test_a_bad_clip_is_left_out_with_a_warning(tmp_path):
    write_clip(tmp_path / "data" / "video01_00000", frames=4)
    bad = tmp_path / "data" / "video02_00000"
    bad.mkdir()
    (bad / "frame_0_endo.png").write_bytes(b"")
    data = made(tmp_path)
    with pytest.warns(UserWarning, match="video02_00000 is left out"):
        data.prepare_data()
    assert len(data.clips) == 1


def test_impossible_settings_are_refused(tmp_path):
    shares = (0.0, 0.5, 0.5), (0.5, 0.5), (0.7, 0.4, 0.2), (7.0, 2.0, 1.0), (1.3, -0.2, -0.1), (0.7, 0.2, float("nan"))
    for wrong in ({"batch_size": 0}, {"num_workers": -1}, *({"fractions": each} for each in shares)):
        with pytest.raises(ValueError, match=next(iter(wrong))):
            LoadingSettings(**wrong)
    assert LoadingSettings(fractions=(0.33, 0.33, 0.33)).fractions == (0.33, 0.33, 0.33)
    with pytest.raises(ValueError, match=r"samples\.geometry differs from geometry"):
        ClipDataModule(str(tmp_path), geometry=GRID)
