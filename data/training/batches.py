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
from palpate.physics.msd.batch import Direction, ObservationBatch, PairBatch
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


def collate(samples: Sequence[Sample]) -> PairBatch:
    """Join samples of `SampleDataset` into a batch; unobserved motion has weight 0."""
    known = [sample.known for sample in samples if sample.known is not None]
    shared: dict[str, Any] = {}
    if len(known) == len(samples):
        features = np.stack([dent_features(interaction, within=0.0) for interaction in known])
        shared["contact_features"] = torch.from_numpy(features)
        shared |= {"known_loads": [interaction.load for interaction in known], "dents": list(map(dent_of, known))}

    def direction(side: str) -> Direction:
        names = "window", "interaction", "course"
        windows, interactions, courses = ([getattr(each, f"{name}_{side}") for each in samples] for name in names)
        observations = [interaction.observation for interaction in interactions]
        return Direction(
            window=torch.from_numpy(np.stack(windows)),
            course=torch.tensor(courses),
            meshes=[interaction.mesh for interaction in interactions],
            loads=[interaction.load for interaction in interactions],
            observation=ObservationBatch.of(observations, interactions[0].time_step),
            **shared,
        )

    frames = torch.tensor([sample.frame for sample in samples])
    return PairBatch([sample.clip for sample in samples], frames, direction("a"), direction("b"))


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
    """Standard deviation of every pixel's error [scene units]; larger where errors are correlated in time."""
    sequence, noise = contact.sequence, network_noise(contact)
    correlated = sequence is not None and len(sequence.times) and not sequence.noise.rounded
    return noise * math.sqrt(sequence.noise.correlated_in_time) if correlated else noise
