"""The descent beside Gauss–Newton: what counts as arrived, and which solves are told."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from types import SimpleNamespace

import pytest
from rich.console import Console

from palpate.estimators.palpation.bench import Progress
from palpate.evaluation.file_table import FileTable
from palpate.evaluation.palpation import descents
from palpate.evaluation.palpation.descents import MOST, arrival, compare
from palpate.evaluation.palpation.frank import YOUNG
from palpate.evaluation.palpation.synthetic import BODIES, press


def test_e_has_arrived_once_it_stays_near() -> None:
    """Passing by on the way to elsewhere is no arrival."""
    path = [Progress(young, 0.4, solves, 3 * solves) for young, solves in ((30, 1), (1.02, 4), (0.8, 7), (1.04, 9))]
    assert arrival(path) is path[3]
    assert arrival([*path, Progress(1.0, 0.4, 12, 36)]) is path[3]
    assert arrival(path[:1]) is path[0]


def fitted(young: float, solves: int, noise: float = 1.0, begun: tuple[float, int] = (2 * YOUNG, 0)) -> SimpleNamespace:
    path = [Progress(begun[0], 0.4, begun[1], 5 * begun[1]), Progress(young, 0.4, solves, 5 * solves)]
    return SimpleNamespace(young=young, poisson=0.4, path=path, noise=noise)


def test_both_methods_solves_are_told(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """From the first start the descent stops short; from the second it arrives, apart from Gauss–Newton.

    There a softer start was tried before, which does not count.
    """
    small = dataclasses.replace(BODIES["slab"], size=0.08)
    monkeypatch.setitem(descents.BODIES, "slab", small)
    monkeypatch.setattr(descents, "true_press", lambda *arguments: press(small, YOUNG, 0.42, 0.5, (0.6, 0.5), 3))
    monkeypatch.setattr(descents, "CELLS", 3)
    there = fitted(YOUNG, 1)
    short = fitted(2 * YOUNG, MOST, 1.01, (30 * YOUNG, 0))
    ends = iter([short, there, fitted(1.06 * YOUNG, 61, 0.99, (4 / 30 * YOUNG, 1)), there])
    asked = []

    def fit(skin: object, held: object, seen: object, settings: SimpleNamespace, most: int = 0) -> SimpleNamespace:
        if most != 1:
            asked.append(settings.young)
        return next(ends) if most else fitted(YOUNG, 6)

    monkeypatch.setattr(descents, "fit_material", fit)
    monkeypatch.setattr(descents, "descend", fit)
    table = FileTable(tmp_path, Console(stderr=True))
    compare("slab", table)
    assert asked == pytest.approx([30 * YOUNG, 30 * YOUNG, YOUNG / 30, YOUNG / 30])
    found = {(row["file"], row["measure"]): row["value"] for row in table.rows}
    stiff, soft = "slab, start E × 30", "slab, start E × 0.0333"
    assert found[stiff, "descent: E that it could begin at / truth"] == 30
    assert found[soft, "descent: E that it could begin at / truth"] == pytest.approx(4 / 30)
    assert found[stiff, "descent: equilibria until E within 5%"] == f"never, after {MOST}"
    assert found[stiff, "Gauss–Newton: linear systems until E within 5%"] == 30
    assert (stiff, "equilibria until E within 5%, descent / Gauss–Newton") not in found
    assert found[stiff, "descent: equilibria until the end"] == f"never, after {MOST}"
    assert found[soft, "descent: linear systems until E within 5%"] == 300
    assert found[soft, "linear systems until E within 5%, descent / Gauss–Newton"] == 10
    assert found[soft, "equilibria until the end, descent / Gauss–Newton"] == 10
    assert found[soft, "descent: E / truth - 1"] == pytest.approx(0.06)
