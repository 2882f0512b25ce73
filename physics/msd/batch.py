"""Observations of a batch, joined into tensors."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Self

import numpy as np
import torch
from torch import Tensor
from torch.nn.utils.rnn import pad_sequence

from palpate.physics.observation import Observation


@dataclass
class ObservationBatch:
    """Observed displacements of one followed point a sample, at up to M instants."""

    steps: Tensor
    """Index into the trajectory that each observation belongs to, shape [B, M], int64."""
    displacement: Tensor
    """Observed displacement from rest, shape [B, M, 3], float32 [scene units]."""
    weight: Tensor
    """Weight of each observation, 0 for padding, shape [B, M], float32."""

    @classmethod
    def of(cls, observations: Sequence[Observation], time_step: float) -> Self:
        """Join observations of one point each, for trajectories with this time step [s]; what was not observed weighs
        0."""
        steps = [torch.from_numpy(observation.steps(time_step)) for observation in observations]
        moved = [torch.from_numpy(item.displacement.squeeze(0).astype(np.float32)) for item in observations]
        weight = [points.isfinite().all(dim=1).float() for points in moved]
        return cls(*(pad_sequence(values, batch_first=True) for values in (steps, moved, weight)))
