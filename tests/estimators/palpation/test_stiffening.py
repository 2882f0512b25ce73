"""How curves stiffen, and intervals of forces beyond their depths, on laws that are fitted and on laws that are not."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from palpate.data.source.layout import InputError
from palpate.estimators.palpation.curves import read_pull
from palpate.estimators.palpation.stiffening import fit_stiffening, told

Law = Callable[[np.ndarray, float], np.ndarray]
FINE = np.linspace(0, 2, 2001)


def integrated(stiffness: Law) -> Law:
    """Force whose stiffness is a function of depth and of what grows."""

    def force(depth: np.ndarray, growth: float) -> np.ndarray:
        along = stiffness(FINE, growth)
        return np.interp(depth, FINE, np.concatenate([[0], np.cumsum(along[1:] + along[:-1]) * FINE[1] / 2]))

    return force


def fung(depth: np.ndarray, growth: float) -> np.ndarray:
    return np.expm1(growth * depth) / growth


LAWS: dict[str, Law] = {
    "Fung": fung,
    "second order": lambda depth, growth: depth + np.expm1(growth) / 2 * depth**2,
    "third order": lambda depth, growth: depth + np.expm1(growth) / 3 * depth**3,
    "Ogden": lambda depth, growth: (1 + 0.4 * depth) ** (1 + 4 * growth) - (1 + 0.4 * depth) ** (-2 - 2 * growth),
    "straight and Fung": integrated(lambda depth, growth: 1 + 0.1 * np.expm1(1.8 * growth * depth)),
    "fibres grow taut": integrated(lambda depth, growth: 1 + 7 * growth * (1 + np.tanh(2 * (depth - 1.3)))),
}


@pytest.mark.parametrize("law", LAWS.values(), ids=LAWS)
def test_intervals_beyond_the_curve_hold_or_it_is_not_told(law: Law) -> None:
    """From the smaller half, at a quarter, a half and all of it further."""
    chance, further = np.random.default_rng(11), np.array([1.25, 1.5, 2.0])
    inside, known, near = [], [], []
    for case in range(45):
        depth, noise = np.linspace(0, 1, (12, 60, 250)[case % 3]), (0.01, 0.005, 0.01)[case % 3]
        growth = chance.uniform(0.6, 2.0)
        clean, truth = law(depth, growth), law(further, growth)
        middle, low, high = fit_stiffening(depth, clean + noise * clean.max() * chance.normal(size=len(depth))).force(
            further
        )
        inside.append((low <= truth) & (truth <= high))
        known.append(told(middle, low, high))
        near.append(np.abs(middle / truth - 1) <= 0.25)
    held, sure, close = np.array(inside), np.array(known), np.array(near)
    assert (held.mean(axis=0) >= 0.85).all()
    assert held[sure].mean() >= 0.9
    assert close[sure].mean() >= 0.95
    assert sure[:, 0].mean() > 0.5  # refusing all would hold as well
    assert not sure[:, 2].any()


def test_fung_s_numbers_come_back_and_a_straight_line_does_not_stiffen() -> None:
    depth, chance = np.linspace(0, 4, 60), np.random.default_rng(2)
    rate_held, stiffness_held = [], []
    for _ in range(40):
        rate = chance.uniform(0.2, 0.6)
        found = fit_stiffening(depth, 0.3 * fung(depth, rate) + chance.normal(0, 0.01, 60))
        assert found.stiffens
        stiffness, growth = found.numbers
        assert growth[0] == pytest.approx(rate, rel=0.4)
        rate_held.append(growth[1] <= rate <= growth[2])
        stiffness_held.append(stiffness[1] <= 0.3 <= stiffness[2])
        assert not fit_stiffening(depth, 0.3 * depth + chance.normal(0, 0.01, 60)).stiffens
    assert np.mean(rate_held) >= 0.85
    assert np.mean(stiffness_held) >= 0.85


def test_a_pull_s_loading_is_read(tmp_path: Path) -> None:
    """Three cycles of which only the first stretches virgin tissue; the way back is softer by a quarter."""
    way, chance = np.linspace(0, 4, 100), np.random.default_rng(3)
    pull = np.concatenate([way, way[::-1], way]) + chance.normal(0, 0.01, 300)
    force = np.concatenate([fung(way, 0.3), 0.75 * fung(way[::-1], 0.3), 0.75 * fung(way, 0.3)])
    rows = [f"{at:.4f},{each:.4f}" for at, each in zip(pull, force, strict=True)]
    (tmp_path / "pull.csv").write_text("pull_mm,force_N\n" + "\n".join(rows))
    read = read_pull(tmp_path / "pull.csv")
    assert 60 < len(read.depth) <= 100
    assert np.abs(read.force - fung(read.depth, 0.3)).max() < 0.15
    _, low, high = fit_stiffening(read.depth, read.force).force(np.array([6.0]))
    assert low[0] < fung(np.array(6.0), 0.3) < high[0]


SKIN: dict[str, Law] = {
    "Fung": lambda depth, growth: fung(depth, np.log(growth)),
    "second order": lambda depth, growth: depth + (growth - 1) / 2 * depth**2,
    "toe, then straight": integrated(lambda depth, growth: 1 + (growth - 1) / (1 + np.exp((0.6 - depth) / 0.12))),
    "locks": integrated(lambda depth, growth: (1 - np.minimum(depth, 1) * (1 - growth**-0.5)) ** -2),
}


@pytest.mark.parametrize("by_force", [True, False])
def test_forces_of_skin_that_stiffens_fifteenfold_are_told_or_not(tmp_path: Path, by_force: bool) -> None:
    """Cycles to 2.5 N that creep and lose a third, cut at half of the force or of the pull."""
    tables, near, sure = [], [], []
    for case, law in enumerate(8 * list(SKIN.values())):
        chance = np.random.default_rng(case)
        way, creep = np.linspace(0, 1, int(chance.integers(30, 150))), chance.uniform(0, 0.05, 3)
        up = 2.5 * law(way, 15.0) / law(np.array(1.0), 15.0)
        force = [each for late in creep for each in (np.interp(way - late, way, up), 0.7 * up[::-1])]
        pull = 12 * np.concatenate([way, way[::-1]] * 3)
        seen = np.concatenate([up, *force[1:]]) + chance.normal(0, 0.012, len(pull))
        kept = seen <= 1.25 if by_force else pull <= 6
        text = "\n".join(f"{at:.3f}, {each:.3f}" for at, each in zip(pull[kept], seen[kept], strict=True))
        (tmp_path / "pull.csv").write_text(f"pull_mm, force_N\n{text}")
        read = read_pull(tmp_path / "pull.csv")
        assert read.depth.max() < 12 * way[np.searchsorted(up, 1.35)] if by_force else 6
        beyond = ~kept & (np.arange(len(pull)) < len(way))
        middle, low, high = fit_stiffening(read.depth, read.force).force(pull[beyond])
        known = told(middle, low, high)
        tables.append(((low <= seen[beyond]) & (seen[beyond] <= high)).mean() >= 0.8)
        near.append(np.abs(middle / seen[beyond] - 1)[known] <= 0.25)
        sure.append(known.mean())
    assert np.mean(tables) >= 0.8
    assert np.concatenate(near).mean() >= 0.95
    assert np.mean(sure) > (0.4 if by_force else 0.1)


@pytest.mark.parametrize(
    ("rows", "says"),
    [
        (["4,1", "3,1", "2,1", "1,0"], "0 values of pull_mm that grow"),
        (["1,-1", "2,-2", "3,-3", "4,-4"], "falls as pull_mm grows"),
        (["0,0", "1,1", "2,2"], "has 3 values"),
        (["0,0", "0.001,0.5", "0.002,1", "0.003,2"], "resists by 650 N/mm over 0.003 mm, as no tissue does"),
        (["0,0", "0.01,0.1", "0.02,0.3", "0.03,0.6"], "over 0.03 mm, as no tissue does; give pull_mm in millimetres"),
        (
            ["0,0", "4000,0.5", "8000,1", "12000,2"],
            r"over 1\.2e\+04 mm, as no tissue does; give pull_mm in millimetres",
        ),
    ],
)
def test_pulls_that_say_nothing_are_a_sentence(tmp_path: Path, rows: list[str], says: str) -> None:
    (tmp_path / "pull.csv").write_text("\n".join(["pull_mm,force_N", *rows]))
    with pytest.raises(InputError, match=says):
        read_pull(tmp_path / "pull.csv")
