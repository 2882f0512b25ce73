"""Samples as torch batches."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import torch
from torch.utils.data import Dataset

from data.clip_cache import PreparedClip
from data.contact_features import contact_features
from data.samples import ContactCase, Sample, SampleSettings, make_sample
from data.splits import Place
from physics.msd import ContactBatch, MeshBatch
from physics.observation import ObservationBatch


class SampleDataset(Dataset):
    """Samples of prepared clips."""

    def __init__(self, clips: Sequence[PreparedClip], places: Sequence[Place], settings: SampleSettings) -> None:
        self.clips, self.places, self.settings = list(clips), list(places), settings

    def __len__(self) -> int:
        return len(self.places)

    def __getitem__(self, index: int) -> Sample:
        clip, frame = self.places[index]
        return make_sample(self.clips[clip], frame, self.settings)


def collate(samples: Sequence[Sample], time_step: float) -> dict[str, Any]:
    """Join samples into a batch.

    Args:
        samples: what `SampleDataset` gives.
        time_step: of the cases' steps [s].

    Returns:
        `window_a`, `window_b` [B, K, h, w] float32; `mesh_a`, `mesh_b` MeshBatch; `contact_a`, `contact_b`
        ContactBatch; `observation_a`, `observation_b` ObservationBatch (padded with weight 0); `clip` names; `frame`
        [B] int64. For trajectories of clips whose noise is known, also what was known of the contact at frame t, the
        same on both sides: `contact_features_a`, … [B, FEATURES] float32 (`data.contact_features`), `noise_a`, … [B]
        float32 [scene units], `seen_contact_a`, … ContactBatch and `seen_observation_a`, … ObservationBatch.
    """
    batch: dict[str, Any] = {
        "clip": [sample.clip for sample in samples],
        "frame": torch.tensor([sample.frame for sample in samples]),
    }
    seen = [sample.seen for sample in samples if sample.seen is not None]
    known = len(seen) == len(samples)
    features = np.stack([contact_features(case, time_step) for case in seen]) if known else None
    for side in ("a", "b"):
        cases: list[ContactCase] = [getattr(sample, f"case_{side}") for sample in samples]
        windows = np.stack([getattr(sample, f"window_{side}") for sample in samples])
        batch[f"window_{side}"] = torch.from_numpy(windows)
        batch[f"mesh_{side}"] = MeshBatch.from_meshes([case.mesh for case in cases])
        batch[f"contact_{side}"] = _join_contacts(cases)
        batch[f"observation_{side}"] = _join_observations(cases)
        if known:
            batch[f"contact_features_{side}"] = torch.from_numpy(features)
            batch[f"noise_{side}"] = torch.tensor([case.noise for case in seen])
            batch[f"seen_contact_{side}"] = _join_contacts(seen)
            batch[f"seen_observation_{side}"] = _join_observations(seen)
    return batch


def _join_contacts(cases: Sequence[ContactCase]) -> ContactBatch:
    return ContactBatch(
        vertex=torch.tensor([case.vertex for case in cases]),
        direction=torch.from_numpy(np.stack([case.direction for case in cases])),
        load_steps=torch.tensor([case.load_steps for case in cases]),
    )


def _join_observations(cases: Sequence[ContactCase]) -> ObservationBatch:
    longest = max(len(case.steps) for case in cases)
    steps = torch.zeros(len(cases), longest, dtype=torch.int64)
    displacement, weight = torch.zeros(len(cases), longest, 3), torch.zeros(len(cases), longest)
    for row, case in enumerate(cases):
        count = len(case.steps)
        steps[row, :count] = torch.from_numpy(case.steps)
        displacement[row, :count] = torch.from_numpy(case.displacement)
        weight[row, :count] = torch.from_numpy(case.weight)
    return ObservationBatch(steps, displacement, weight)
