"""Samples as torch batches."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import torch
from torch.utils.data import Dataset

from data.cache import PreparedClip
from data.contact.features import contact_features
from data.contact.interaction import Interaction
from data.training.samples import Sample, SampleSettings, make_sample
from data.training.splits import Place
from physics.msd.batch import MeshBatch, ObservationBatch, PressBatch


class SampleDataset(Dataset):
    """Samples of prepared clips."""

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
        `window_a`, `window_b` [B, K, h, w] float32; `mesh_a`, `mesh_b` MeshBatch; `load_a`, `load_b` PressBatch;
        `observation_a`, `observation_b` ObservationBatch (padded with weight 0); `course_a`, `course_b` [B, 2] int64,
        the rollout's steps at the window's last frame and the one that is predicted; `clip` names; `frame` [B] int64.
        For trajectories of clips whose noise is known, also what was known of the contact at frame t, the same on both
        sides: `contact_features_a`, … [B, FEATURES] float32 (`data.contact.features`), `noise_a`, … [B] float32
        [scene units], `seen_load_a`, … PressBatch and `seen_observation_a`, … ObservationBatch.
    """
    batch: dict[str, Any] = {
        "clip": [sample.clip for sample in samples],
        "frame": torch.tensor([sample.frame for sample in samples]),
    }
    seen = [sample.seen for sample in samples if sample.seen is not None]
    known = len(seen) == len(samples)
    features = np.stack([contact_features(interaction) for interaction in seen]) if known else None
    for side in ("a", "b"):
        interactions: list[Interaction] = [getattr(sample, f"interaction_{side}") for sample in samples]
        windows = np.stack([getattr(sample, f"window_{side}") for sample in samples])
        batch[f"window_{side}"] = torch.from_numpy(windows)
        batch[f"course_{side}"] = torch.tensor([getattr(sample, f"course_{side}") for sample in samples])
        batch[f"mesh_{side}"] = MeshBatch.from_meshes([interaction.mesh for interaction in interactions])
        batch[f"load_{side}"], batch[f"observation_{side}"] = _join(interactions)
        if known:
            batch[f"contact_features_{side}"] = torch.from_numpy(features)
            batch[f"noise_{side}"] = torch.tensor([interaction.noise for interaction in seen], dtype=torch.float32)
            batch[f"seen_load_{side}"], batch[f"seen_observation_{side}"] = _join(seen)
    return batch


def _join(interactions: Sequence[Interaction]) -> tuple[PressBatch, ObservationBatch]:
    observations = [interaction.observation for interaction in interactions]
    loads = PressBatch.of([interaction.load for interaction in interactions])
    return loads, ObservationBatch.of(observations, interactions[0].time_step)
