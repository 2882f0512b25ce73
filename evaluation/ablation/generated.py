"""What a trained generator makes of a clip: θ as its own head says it, and the picture some frames ahead."""

from pathlib import Path

import numpy as np
import torch

from palpate.data.contact.features import FEATURES, contact_features
from palpate.data.contact.sequence_features import SEQUENCE_FEATURES, dent_features
from palpate.data.windows import window_indices
from palpate.evaluation.ablation.watched import WatchedClip
from palpate.models.carried_depth import change, shifted
from palpate.models.checkpoint import load_generator
from palpate.models.generator import ContactHead
from palpate.physics.mechanics import Mechanics
from palpate.physics.msd.batch import MeshBatch, PressBatch


class TrainedGenerator:
    """G_AB of a checkpoint.

    Args:
        path: what `train.py fit` wrote.

    Raises:
        CheckpointError: it can't be used.
    """

    def __init__(self, path: Path) -> None:
        self.generator, self.mechanics, self.horizon = load_generator(path)
        """G_AB, the constants of its rollouts, and how many frames ahead it predicts."""

    @torch.no_grad()
    def estimate(self, clip: WatchedClip, now: int) -> np.ndarray:
        """θ from what was observed up to a frame, as a training sample of that frame has it, shape [3]."""
        features, head = self.generator.encode(self._window(clip, now)), self.generator.head
        given = None
        if isinstance(head, ContactHead):
            contact = clip.run.build(self.mechanics, until=clip.since(now))
            with_sequence = len(head.posterior.centre) == FEATURES + SEQUENCE_FEATURES
            vector = dent_features(contact, within=0.0) if with_sequence else contact_features(contact)
            given = torch.from_numpy(vector)[None]
        return self.generator.answer(features, given).theta[0].double().numpy()

    @torch.no_grad()
    def picture(self, clip: WatchedClip, now: int, theta: np.ndarray) -> np.ndarray:
        """The depth `horizon` frames after a frame if θ [3] is the truth, shape [h, w]."""
        start = None
        if self.generator.decoder.kind == "physics":
            start = torch.from_numpy(carried_ahead(clip, now, self.horizon, theta, self.mechanics))[None, None]
        given = torch.tensor(theta[None], dtype=torch.float32)
        return self.generator.generate(self._window(clip, now), given, start)[0, 0].numpy()

    def _window(self, clip: WatchedClip, now: int) -> torch.Tensor:
        frames = clip.frames
        consecutive, usable = np.array([(frame.consecutive, frame.has_depth) for frame in frames]).T
        indices = window_indices(now, self.generator.channels, consecutive, usable)
        if indices is None:
            raise ValueError(f"There is no depth around frame {now}; take one of the clip's instants.")
        return torch.from_numpy(np.stack([frames[index].depth for index in indices]))[None]


def carried_ahead(clip: WatchedClip, now: int, horizon: int, theta: np.ndarray, mechanics: Mechanics) -> np.ndarray:
    """A frame's depth as θ [3] alone makes it so many frames later, shape [h, w]."""
    contact = clip.run.build(mechanics)
    course = np.rint([[clip.since(now) / mechanics.time_step, clip.since(now + horizon) / mechanics.time_step]])
    sheet = MeshBatch.from_meshes([contact.mesh]), PressBatch.of([contact.load])
    given = torch.tensor(theta[None], dtype=torch.float32), *sheet, torch.tensor(course, dtype=torch.int64)
    with torch.no_grad():
        by = change(*given, mechanics)
    return shifted(torch.from_numpy(clip.frames[now].depth)[None, None], by)[0, 0].numpy()
