"""A scene's parts, whatever made it, by the names that kinds.yaml has."""

from dataclasses import dataclass
from typing import Any

import numpy as np

from palpate.common.files import read_beside
from palpate.physics.load import Grip, Press

KINDS: dict[str, Any] = read_beside(__file__, "kinds.yaml")["kinds"]
"""By name: what they are about, in which unit of length, and of each part group, numbers a row, type and unit."""
FORMATS: dict[str, Any] = read_beside(__file__, "formats.yaml")
"""How each format holds a scene."""


@dataclass(frozen=True, eq=False)
class Scene:
    """Tissue, what is known of it, and what moves it; `simulated` gives the motion. Made by `make_scene`."""

    kind: str
    """One of KINDS."""
    parts: dict[str, np.ndarray]
    """By name, each of shape [rows, numbers a row]."""

    def number(self, name: str) -> Any:
        """The first number of a part: of an estimate its value, which both ends of its 90 % interval follow."""
        return self.parts[name].flat[0].item()

    @property
    def press(self) -> Press:
        """The load of a scene whose tissue is pressed."""
        vertices, *rest = (
            self.parts[f"load_{name}"].ravel() for name in ("vertices", "weights", "direction", "factor")
        )
        return Press(vertices.astype(np.int64), *rest)

    @property
    def grip(self) -> Grip:
        """The load of a scene whose tissue is gripped."""
        vertices = self.parts["grip_vertices"].ravel().astype(np.int64)
        return Grip(vertices, self.parts["grip_path"].reshape(-1, len(vertices), 3))


def make_scene(kind: str, **values: Any) -> Scene:
    """A scene of such parts, in the types that the kind has; `model` need not be given."""
    values["model"] = list(KINDS).index(kind)
    table = KINDS[kind]["parts"].items()
    return Scene(kind, {name: np.asarray(values[name], part[2]).reshape(-1, part[1]) for name, part in table})
