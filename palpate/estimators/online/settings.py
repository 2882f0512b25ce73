"""Everything that the online estimator can be given; `configs/online.yaml` holds the same with the reasons."""

from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated

from palpate.common.settings import LARGEST, Checked, NotNegative, Positive
from palpate.data.source.layout import from_mapping, read_mapping
from palpate.estimators.online.objective import Bounds, Mapping, Objective, Weights
from palpate.estimators.online.session import Method
from palpate.physics.pbd.simulation import Stepping

MOST_FITTED = 50
"""Frames that can be fitted to; every one is kept until then."""


@dataclass(frozen=True)
class Start(Checked, group="the start of "):
    """Stiffness to begin with, the same everywhere.

    Raises:
        ValueError: a stiffness that is not positive.
    """

    distance: Positive = 1.0
    """Stiffness of distances [m/Δt²]: the paper's second start."""
    shape: Positive = 0.01
    """Stiffness of shapes, likewise: the paper's 0.1 lies outside its own bound of 0.02."""


@dataclass(frozen=True)
class OnlineSettings(Checked):
    """Settings of the online estimator: how driven tissue is followed, and its stiffness found.

    Raises:
        ValueError: a value out of range, or two that don't belong together.
    """

    particles: Annotated[int, 30, 10_000] = 600
    """Approximate number of particles, all layers of a volume together (Liang 2024, section III)."""
    thickness: Positive | None = None
    """Thickness of the tissue along its surface's normal [scene units]; None = a sheet."""
    points: Annotated[int, 1, LARGEST] = 9000
    """Largest number of points of a sequence's cloud (Liang 2024, section III)."""
    strain: NotNegative = 0.03
    """Stiffness can be known only where an edge was once longer or shorter than at rest by more than this share."""
    fitted: Annotated[int, 0, MOST_FITTED] = 5
    """Time step, foundation and the stiffness of shapes are fitted to the first so many frames of a run, by simulation
    alone, within the bounds; the values given here hold until then. 0 = they hold throughout."""
    start: Start = field(default_factory=Start)
    """Stiffness to begin with."""
    method: Method = field(default_factory=Method)
    """Parts of the step that run, and how fast stiffness is changed."""
    bounds: Bounds = field(default_factory=Bounds)
    """Largest stiffness; where frames are fitted to, of shapes also at most as many times that of distances as is
    chosen there."""
    stepping: Stepping = field(default_factory=Stepping)
    """Time steps; a frame is one."""
    mapping: Mapping = field(default_factory=Mapping)
    """Search of the residual deformation."""
    elastic: NotNegative = Objective.elastic
    """k⁰ of the mapping, as `Objective` has it."""
    weights: Weights = field(default_factory=Weights)
    """Weights of the objective's terms."""

    def __post_init__(self) -> None:
        """Check ranges."""
        super().__post_init__()
        for name in ("distance", "shape"):
            begun, bound = getattr(self.start, name), getattr(self.bounds, name)
            if not begun < bound:
                raise ValueError(f"the start of {name} is {begun:g}, its bound {bound:g}; begin inside.")


def load_settings(path: Path) -> OnlineSettings:
    """Read settings from a YAML file; what it leaves out keeps its default.

    Raises:
        InputError: unreadable file, an unknown key, or an impossible value.
    """
    return from_mapping(OnlineSettings, read_mapping(path, "a file of settings"), str(path))
