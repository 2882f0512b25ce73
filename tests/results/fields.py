"""Fields of stiffness and grips, and what is found of one over a run of contact."""

import dataclasses
from argparse import Namespace
from collections.abc import Sequence
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import numpy as np

from palpate.data.source.frames import FrameSource
from palpate.estimators.contract import Estimator
from palpate.estimators.grip.grip_estimate import PullResult
from palpate.estimators.online.driven import DrivenTissue
from palpate.estimators.online.particle_field import FieldResult, ParticleField, StiffnessMap
from palpate.results.artefacts.base import Artefact, artefacts
from palpate.results.writer import ClipResults

REST = np.array([[0, 0, 1], [1, 0, 1], [0, 1, 1], [1, 1, 1]], float)
FIELD_SEEN = ParticleField(
    onset_frame=3, rest=REST, faces=np.array([[0, 1, 2], [1, 3, 2]]), tetrahedra=np.empty((0, 4), int),
    positions=REST + 0.5, pixels=np.array([[4, 4], [44, 4], [4, 34], [44, 34]], float),
    distance=StiffnessMap(
        np.array([4.0, 4.0, 4.0, 64.0]), np.array([0.2, 0.3, 0.4, 0.9]), np.array([True, True, True, False])
    ),
    shape=StiffnessMap(np.full(4, 0.01), np.full(4, 0.8), np.zeros(4, bool)), skill=0.75, gap=0.25,
)  # fmt: skip
TIMES = np.array([0.0, 0.04, 0.08])
PULL = FieldResult(
    last=FIELD_SEEN, times=TIMES,
    course=np.array([[0.0, 0.0, 0.0], [2.0, 1.5, 0.6], [5.0, 4.2, 1.0]]),
    stretched=True, driven=cast(DrivenTissue, None),
)  # fmt: skip
_SECONDS = np.arange(1.0, 4.0)
GRIP = PullResult(0.6, 0.1, _SECONDS, _SECONDS / 3, np.array([0.02, 0.03, 0.0]))
"""A pull whose relative force is determined."""
UNKNOWN = dataclasses.replace(FIELD_SEEN, distance=dataclasses.replace(FIELD_SEEN.distance, known=np.zeros(4, bool)))
SIZE = (64, 48)


def opened(folder: Path, *, overlay: bool = False, kinds: Sequence[type[Artefact]] = (), **given: Any) -> ClipResults:
    """Results of a clip of SIZE that are to be written."""
    options = Namespace(overlay=overlay, bag=None, export=None, force_scale=given.get("calibration"))
    source = cast(FrameSource, SimpleNamespace(size=SIZE, fps=25.0, name="clip"))
    return ClipResults(
        folder, source, [*artefacts(options, cast(Estimator, SimpleNamespace(tells_field=False))), *kinds], **given
    )
