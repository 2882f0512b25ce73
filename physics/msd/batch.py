"""Observations of a batch, joined into tensors."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol, Self

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


class DepthView(Protocol):
    """What a camera sees of a mesh; V vertices that may be seen, P pixels."""

    vertices: np.ndarray
    """Each an index within the mesh, shape [V]."""

    def seen(self, moved: np.ndarray, slopes: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Change of every pixel's depth since rest [N, P], and its derivatives [N, P, D].

        Args:
            moved, slopes: displacements of the vertices [N, V, 3] and their derivatives [N, V, 3, D].

        Returns:
            Not a number where a pixel shows nothing known.
        """


@dataclass
class DepthBatch:
    """Observed changes of the depth of P pixels a sample, at up to N instants."""

    views: Sequence[DepthView]
    """What the pixels show, B of them."""
    vertices: Tensor
    """Theirs, each an index within its own mesh, filled up with any of them, shape [B, V], int64."""
    steps: Tensor
    """Index into the trajectory that each instant belongs to, shape [B, N], int64."""
    change: Tensor
    """Observed change since rest, shape [B, N, P], float32 [scene units]; 0 where nothing was observed."""
    weight: Tensor
    """Whether it was observed, shape [B, N, P], float32."""
    noise: Tensor
    """σ of every observed change, shape [B], float32 [scene units]."""
    common: Tensor
    """Errors that all instants share, independent normal factors of these columns, shape [P, K], float32 [σ]."""
