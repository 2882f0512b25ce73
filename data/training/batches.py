"""Samples as torch batches."""

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
import torch
from torch.utils.data import Dataset

from palpate.data.cache import PreparedClip
from palpate.data.contact.interaction import Interaction
from palpate.data.contact.sequence_features import dent_features, network_noise
from palpate.data.training.samples import Sample, SampleSettings, make_sample
from palpate.data.training.splits import Place
from palpate.physics.depth import DepthLikelihood, DepthSequence, SequenceNoise
from palpate.physics.load import Press
from palpate.physics.msd.batch import ObservationBatch
from palpate.physics.patches import REACH, Patches


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
        `known_load_a`, … B presses and `dent_a`, … B depth likelihoods.
    """
    batch: dict[str, Any] = {"clip": [sample.clip for sample in samples]}
    batch["frame"] = torch.tensor([sample.frame for sample in samples])
    known = [sample.known for sample in samples if sample.known is not None]
    all_known = len(known) == len(samples)
    shared: dict[str, Any] = {}
    if all_known:
        features = np.stack([dent_features(interaction, within=0.0) for interaction in known])
        shared["contact_features"] = torch.from_numpy(features)
        shared |= {"known_load": [interaction.load for interaction in known], "dent": list(map(dent_of, known))}
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


def dent_of(contact: Interaction) -> DepthLikelihood:
    """Likelihood of a contact's depth-change sequence; without one, of its own motion, as the middle pixel's."""
    sequence, noise = contact.sequence, _sequence_noise(contact)
    if sequence is not None and len(sequence.times):
        return DepthLikelihood(contact.mesh, contact.vertex, sequence, noise)
    change = np.full((len(contact.observation), 2 * REACH + 1, 2 * REACH + 1), np.nan, np.float32)
    size = contact.mesh.grid_shape[::-1]
    nothing = DepthSequence(contact.observation.times, change, SequenceNoise(noise, 0.0), size)
    patches = Patches(contact.mesh, contact.vertex, size)
    change[:, REACH, REACH] = patches.sunk(contact.moved[:, None], np.flatnonzero(patches.vertices == contact.vertex))[
        :, 0
    ]
    return DepthLikelihood(contact.mesh, contact.vertex, nothing)


def _sequence_noise(contact: Interaction) -> float:
    """σ of every pixel's error [scene units]; larger where errors are correlated in time, like fewer pixels."""
    sequence, noise = contact.sequence, network_noise(contact)
    correlated = sequence is not None and len(sequence.times) and not sequence.noise.rounded
    return noise * math.sqrt(sequence.noise.correlated_in_time) if correlated else noise
