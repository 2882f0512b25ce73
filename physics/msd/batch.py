"""Observations of a batch, joined into tensors."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Self

import numpy as np
import torch
from torch import Tensor
from torch.nn.utils.rnn import pad_sequence

from palpate.physics.depth import DepthLikelihood
from palpate.physics.load import Press
from palpate.physics.mesh import Mesh
from palpate.physics.observation import Observation


@dataclass
class ObservationBatch:
    """Observed displacements of one tracked point a sample, at up to M instants."""

    steps: Tensor
    """Index into the trajectory that each observation belongs to, shape [B, M], int64."""
    displacement: Tensor
    """Observed displacement from rest, shape [B, M, 3], float32 [scene units]."""
    weight: Tensor
    """Weight of each observation, 0 for padding, shape [B, M], float32."""

    @classmethod
    def of(cls, observations: Sequence[Observation], time_step: float) -> Self:
        """Join observations of one point each, for trajectories with a time step [s]; missing ones weigh 0."""
        steps = [torch.from_numpy(observation.steps(time_step)) for observation in observations]
        moved = [torch.from_numpy(item.displacement.squeeze(0).astype(np.float32)) for item in observations]
        weight = [points.isfinite().all(dim=1).float() for points in moved]
        return cls(*(pad_sequence(values, batch_first=True) for values in (steps, moved, weight)))


@dataclass
class Direction:
    """Frames of B pairs in one direction of time, and the contacts that the simulator replays."""

    window: Tensor
    """Depth maps, the current frame last, shape [B, K, h, w], float32."""
    course: Tensor
    """Steps of the rollout at the current frame and at the predicted one, shape [B, 2], int64."""
    meshes: Sequence[Mesh]
    """Tissue at rest, B of them."""
    loads: Sequence[Press]
    """Presses, B of them."""
    observation: ObservationBatch
    """Observed displacements of the contacts."""
    contact_features: Tensor | None = None
    """Contacts as known at the current frame, shape [B, features], float32; None without trajectory or noise."""
    known_loads: Sequence[Press] = ()
    """Presses as far as known at the current frame; empty where `contact_features` is None."""
    dents: Sequence[DepthLikelihood] = ()
    """Depth changes up to the current frame; empty where `contact_features` is None."""

    def to(self, device: torch.device) -> Self:
        """The networks' inputs on a device; the rest stays on the CPU, where rollouts are compiled."""
        features = None if self.contact_features is None else self.contact_features.to(device)
        return replace(self, window=self.window.to(device), contact_features=features)


@dataclass
class PairBatch:
    """B pairs of frames t, t + horizon."""

    clips: Sequence[str]
    """Names of the clips."""
    frames: Tensor
    """Indices of t, shape [B], int64."""
    a: Direction
    """Forward in time, from t."""
    b: Direction
    """Backward in time, from t + horizon; the known parts of the contact are those of `a`."""

    def to(self, device: torch.device) -> Self:
        """The networks' inputs on a device."""
        return replace(self, a=self.a.to(device), b=self.b.to(device))
