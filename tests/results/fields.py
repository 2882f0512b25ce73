"""Fields of stiffness and grips, and what is found of one over a run of contact."""

from typing import cast

import numpy as np

from palpate.estimators.grip.grip_estimate import GripEstimate
from palpate.estimators.online.driven import DrivenTissue
from palpate.estimators.online.particle_field import FieldEstimate, ParticleField

REST = np.array([[0, 0, 1], [1, 0, 1], [0, 1, 1], [1, 1, 1]], float)
FIELD_SEEN = ParticleField(
    onset_frame=3, rest=REST, faces=np.array([[0, 1, 2], [1, 3, 2]]), tetrahedra=np.empty((0, 4), int),
    positions=REST + 0.5, pixels=np.array([[4, 4], [44, 4], [4, 34], [44, 34]], float),
    distance=np.array([4.0, 4.0, 4.0, 64.0]), distance_log_sd=np.array([0.2, 0.3, 0.4, 0.9]),
    known=np.array([True, True, True, False]),
    shape=np.full(4, 0.01), shape_log_sd=np.full(4, 0.8), shape_known=np.zeros(4, bool), skill=0.75, gap=0.25,
)  # fmt: skip
TIMES = np.array([0.0, 0.04, 0.08])
_NUMBERS = {"skill": np.array([np.nan, 0.7, 0.75]), "field_known": np.array([0.0, 0.5, 0.75])}
_ENDS = ("_low", "", "_high")
_NUMBERS |= {f"distance_stiffness{end}": np.array([np.nan, 3.0, 4.0]) for end in _ENDS}
_NUMBERS |= {f"shape_stiffness{end}": np.full(3, np.nan) for end in _ENDS}
PULL = FieldEstimate(
    last=FIELD_SEEN, times=TIMES,
    course=np.array([[0.0, 0.0, 0.0], [2.0, 1.5, 0.6], [5.0, 4.2, 1.0]]),
    numbers=_NUMBERS | {"shape_known": np.zeros(3)}, stretched=True, driven=cast(DrivenTissue, None),
)  # fmt: skip
_SECONDS = np.arange(1.0, 4.0)
GRIP = GripEstimate(0.6, 0.1, _SECONDS, _SECONDS / 3, np.array([0.02, 0.03, 0.0]))
"""A pull whose relative force is determined."""
