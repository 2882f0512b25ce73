"""Samples as torch batches."""

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
import torch
from torch.nn.utils.rnn import pad_sequence
from torch.utils.data import Dataset

from palpate.data.cache import PreparedClip
from palpate.data.contact.depth_sequence import REACH, smooth_errors
from palpate.data.contact.interaction import Interaction
from palpate.data.contact.patches import Patches
from palpate.data.contact.sequence_features import dent_features, network_noise
from palpate.data.training.samples import Sample, SampleSettings, make_sample
from palpate.data.training.splits import Place
from palpate.physics.load import Press
from palpate.physics.msd.batch import DepthBatch, ObservationBatch


class SampleDataset(Dataset):
    """Samples of prepared clips; `places` names the clip and the frame of each."""

    def __init__(self, clips: Sequence[PreparedClip], places: Sequence[Place], settings: SampleSettings) -> None:
        self.clips, self.places, self.settings = list(clips), list(places), settings

    def __len__(self) -> int:
        return len(self.places)

    def __getitem__(self, index: int) -> Sample:
        clip, frame = self.places[index]
        return make_sample(self.clips[clip], frame, self.settings)


def collate(samples: Sequence[Sample]) -> dict[str, Any]:
    """Join samples into a batch.

    Args:
        samples: what `SampleDataset` gives.

    Returns:
        `window_a`, `window_b` [B, K, h, w] float32; `mesh_a`, `mesh_b` B meshes; `load_a`, `load_b` B presses;
        `observation_a`, `observation_b` ObservationBatch (padded with weight 0); `course_a`, `course_b` [B, 2] int64,
        the rollout's steps at the window's last frame and at the predicted one; `clip` names; `frame` [B] int64.
        For trajectories of clips whose noise is known, also what was known of the contact at frame t, equal on both
        sides: `contact_features_a`, … [B, FEATURES + SEQUENCE_FEATURES] float32 (`data.contact.sequence_features`),
        `known_load_a`, … B presses and `dent_a`, … DepthBatch.
    """
    batch: dict[str, Any] = {"clip": [sample.clip for sample in samples]}
    batch["frame"] = torch.tensor([sample.frame for sample in samples])
    known = [sample.known for sample in samples if sample.known is not None]
    all_known = len(known) == len(samples)
    shared: dict[str, Any] = {}
    if all_known:
        features = np.stack([dent_features(interaction, within=0.0) for interaction in known])
        shared["contact_features"] = torch.from_numpy(features)
        shared |= {"known_load": [interaction.load for interaction in known], "dent": join_sequences(known)}
    for side in ("a", "b"):
        interactions: list[Interaction] = [getattr(sample, f"interaction_{side}") for sample in samples]
        windows = np.stack([getattr(sample, f"window_{side}") for sample in samples])
        batch[f"window_{side}"] = torch.from_numpy(windows)
        batch[f"course_{side}"] = torch.tensor([getattr(sample, f"course_{side}") for sample in samples])
        batch[f"mesh_{side}"] = [interaction.mesh for interaction in interactions]
        batch[f"load_{side}"], batch[f"observation_{side}"] = _join(interactions)
        batch |= {f"{name}_{side}": value for name, value in shared.items()}
    return batch


def _join(interactions: Sequence[Interaction]) -> tuple[list[Press], ObservationBatch]:
    """Loads and observations of some interactions."""
    observations = [interaction.observation for interaction in interactions]
    loads = [interaction.load for interaction in interactions]
    return loads, ObservationBatch.of(observations, interactions[0].time_step)


def join_sequences(contacts: Sequence[Interaction]) -> DepthBatch:
    """The depth-change sequences of some contacts, as a batch.

    A contact without a sequence gives its own motion, as the middle pixel's. In a finer picture than the grid the
    middle pixels are left out: they are means of very different depths.
    """
    views, *columns = zip(*map(_sequence_parts, contacts), strict=True)
    steps, change = (pad_sequence([torch.from_numpy(part) for part in column], batch_first=True) for column in columns)
    most = max(len(view.vertices) for view in views)
    # The contact's vertex pads the list, since a far one would have to be simulated.
    vertices = [
        np.pad(view.vertices, (0, most - len(view.vertices)), constant_values=contact.vertex)
        for view, contact in zip(views, contacts, strict=True)
    ]
    instants = torch.tensor([len(part) for part in columns[0]])[:, None] > torch.arange(steps.shape[1])
    weight = change.isfinite() & instants[..., None]
    return DepthBatch(
        views=views,
        vertices=torch.from_numpy(np.stack(vertices)),
        steps=steps,
        change=torch.where(weight, change, 0.0),
        weight=weight.float(),
        noise=torch.tensor([_sequence_noise(contact) for contact in contacts], dtype=torch.float32),
        common=torch.from_numpy(smooth_errors(1.0).astype(np.float32)),
    )


def _sequence_parts(contact: Interaction) -> tuple[Patches, np.ndarray, np.ndarray]:
    """Patches that a contact's pixels show, steps [N] and depth changes [N, P], NaN where nothing was observed."""
    sequence, side = contact.sequence, 2 * REACH + 1
    if sequence is None or not len(sequence.times):
        patches = Patches(contact.mesh, contact.vertex, contact.mesh.grid_shape[::-1])
        moved = np.zeros((len(contact.observation), len(patches.vertices), 3))
        place = int(np.flatnonzero(patches.vertices == contact.vertex)[0])
        moved[:, place] = contact.moved
        change = np.full((len(moved), side * side), np.nan, np.float32)
        change[:, side * side // 2] = patches.sunk(moved)[:, place]
        return patches, contact.observation.steps(contact.time_step), change
    patches = Patches(contact.mesh, contact.vertex, sequence.size)
    change = sequence.change.reshape(len(sequence.times), -1).copy()
    if patches.averages:
        near = np.abs(np.mgrid[-REACH : REACH + 1, -REACH : REACH + 1]).max(axis=0).ravel() <= 1
        change[:, near] = np.nan
    return patches, np.rint(sequence.times / contact.time_step).astype(np.int64) - 1, change


def _sequence_noise(contact: Interaction) -> float:
    """σ of every pixel's error [scene units]; larger where errors are correlated in time, like fewer pixels."""
    sequence, noise = contact.sequence, network_noise(contact)
    correlated = sequence is not None and len(sequence.times) and not sequence.noise.rounded
    return noise * math.sqrt(sequence.noise.correlated_in_time) if correlated else noise
