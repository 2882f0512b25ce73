"""Suites of synthetic clips (suites.yaml), each with one error of observation, and seeds that keep splits apart.

Clip i of a split has the same truth in every suite, because errors of observation have random streams of their own
(`data.synthetic.clip.draw_truth`). Exceptions: `mismatch` moves otherwise on the same geometry, `late-onset` moves the
same, but later, and `oblique` and `filled` have other geometry. Regimes take turns: clip 0 is under-damped, 1 critical,
2 over-damped, 3 under-damped again.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from palpate.data.source.layout import from_mapping
from palpate.data.synthetic.settings import SceneSettings

GRID_SIZE = (214, 120)
"""Width and height of pictures of the network's input size [px]."""
SPLITS = {"training": 1, "validation": 2, "test": 3}
"""First number of each split's random stream."""


@dataclass(frozen=True)
class Suite:
    """One way to observe, or to spoil, the clips of a split; suites.yaml explains the fields."""

    of: str
    """Load that moves the tissue: `press` or `grip`, on a sheet."""
    name: str
    reason: str
    errors: Mapping[str, Any]
    truth: Mapping[str, Any]
    turns: Sequence[Sequence[Mapping[str, Any]]]

    def truth_settings(self, index: int, size: tuple[int, int] = GRID_SIZE) -> SceneSettings:
        """Settings from which the truth of clip `index` is drawn, without errors that leave it as it is.

        Args:
            size: width and height of pictures of presses on a sheet [px].
        """
        found: dict[str, Any] = {"width": size[0], "height": size[1]} if self.of == "press" else {}
        found |= self.truth
        for fields in self.turns:
            index, turn = divmod(index, len(fields))
            found |= fields[turn]
        return from_mapping(SceneSettings, found, f"The suite {self.name}")

    def settings(self, index: int, size: tuple[int, int] = GRID_SIZE) -> SceneSettings:
        """Return the settings of synthetic clips with the suite's errors of observation."""
        return replace(self.truth_settings(index, size), **self.errors)


def _read() -> Iterator[Suite]:
    """All suites, in the order of tables; a field of a suite replaces that of its kind."""
    text = Path(__file__).with_suffix(".yaml").read_text(encoding="utf-8")
    for of, kind in yaml.safe_load(text).items():
        for name, own in kind["suites"].items():
            errors, truth = (kind.get(part, {}) | own.get(part, {}) for part in ("errors", "truth"))
            yield Suite(of, name, own["reason"], errors, truth, kind.get("turns", []) + own.get("turns", []))


EVERY = {suite.name: suite for suite in _read()}
"""All suites by name, in the order of tables."""
SUITES = {name: suite for name, suite in EVERY.items() if suite.of == "press"}
"""Suites of presses on a sheet."""


def suite_clip_seed(split: str, seed: int, index: int) -> int:
    """Seed of a clip, 64 bits: a stream for each split, so that no two splits share geometry or θ at any seed.

    Args:
        split: training, validation or test.
        seed: seed of the benchmark, 0 to 2³² - 1.
        index: number of the clip in its split.
    """
    # The first number tells these streams from any other use of the same seed, such as `data.synthetic.clip.clip_seed`.
    stream = np.random.SeedSequence((0x70A17A7E, SPLITS[split], seed, index))
    return int(stream.generate_state(1, np.uint64)[0])
