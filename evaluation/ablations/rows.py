"""Which rows the ablations have, and what sets each apart."""

from __future__ import annotations

from dataclasses import dataclass

OBSERVATION, TRAINING = "observation", "training"
"""The two families: what is observed of a contact, and how the generators are trained."""
FRAMES = (1, 2, 4, 8, 16, 25)
"""Frames after the onset that are seen; 25 are a second."""


@dataclass(frozen=True)
class Row:
    """One row of the table."""

    family: str
    name: str
    """As `--rows` takes it."""
    what: str
    """What sets it apart, in words."""
    config: str = "configs/recommended.yaml"
    """Configuration file, of a training."""
    options: tuple[str, ...] = ()
    """What a training's command line changes of it."""
    pretrained: bool = True
    """Whether a training begins with the pretrained contact posterior."""
    trained: bool = True
    """Whether there is a training at all; else the pretrained posterior is judged as it is."""

    @property
    def observation(self) -> str:
        """What `evaluation.ablations.observation` calls what it sees."""
        return self.name.removeprefix("K=")


def _without(*terms: str) -> tuple[str, ...]:
    return tuple(part for term in terms for part in (f"--model.weights.{term}", "0"))


def _named(frames: int) -> Row:
    return Row(OBSERVATION, f"K={frames}", f"the first {frames} frame{'s' * (frames > 1)} after the onset")


ROWS = {
    row.name: row
    for row in (
        *(_named(frames) for frames in FRAMES),
        Row(OBSERVATION, "release", "only the frame at the end of the load"),
        Row(OBSERVATION, "final", "only the last frame of the second"),
        Row(OBSERVATION, "supervised", "as K=25, but told the true θ of its simulated contacts: an upper bound"),
        Row(TRAINING, "posterior", "the pretrained posterior as it is, no picture", trained=False),
        Row(TRAINING, "baseline", "configs/recommended.yaml from the pretrained posterior"),
        Row(TRAINING, "no-gan", "without the adversarial term", options=_without("gan")),
        Row(TRAINING, "no-cycle", "without the cycle term", options=_without("cycle")),
        Row(TRAINING, "no-identity", "without the identity term", options=_without("identity")),
        Row(TRAINING, "no-physics", "without the evidence bound", options=_without("physics")),
        Row(TRAINING, "no-regularisation", "without the hinge outside the box", options=_without("regularisation")),
        Row(TRAINING, "no-gan-no-cycle", "without adversary and cycle", options=_without("gan", "cycle")),
        Row(
            TRAINING,
            "full-rate",
            "the pretrained head at the whole learning rate",
            options=("--model.pretrained_rate", "1.0"),
        ),
        Row(TRAINING, "scratch", "from nothing", pretrained=False),
        Row(TRAINING, "paper", "configs/paper.yaml", config="configs/paper.yaml", pretrained=False),
    )
}
"""All rows by name, in the order of the table."""
