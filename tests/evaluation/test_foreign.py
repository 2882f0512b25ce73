"""Ringing measured, a standard linear solid found again, and another mass predicted."""

import os
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from palpate.data.source.layout import InputError
from palpate.evaluation import foreign
from palpate.physics.fem import Relaxation
from tests.tables import read_measures

SOLID = 2.2e5, Relaxation(0.3, 0.04)


def write_beam(path: Path, frequency: float, decay: float) -> Path:
    """A tip at 100 Hz that is held, let go after half a second, and creeps a little."""
    times = np.arange(500) / 100
    since = np.maximum(times - 0.5, 0)
    fall = 0.006 * np.exp(-decay * since) * np.cos(2 * np.pi * frequency * since) + 4e-4 * np.exp(-since / 0.9)
    columns = [times]
    for marker in range(6):
        columns += [0.05 + (fall if marker < 3 else 0 * fall), np.full(500, 0.02 * marker), np.full(500, 0.07)]
    path.parent.mkdir(parents=True, exist_ok=True)
    np.savetxt(path, np.column_stack(columns), delimiter=",", header="t_s," + "m," * 18, comments="")
    return path


def test_frequency_and_decay_are_measured_beside_a_creep(tmp_path: Path) -> None:
    found = foreign.read_ringing(write_beam(tmp_path / "beam_load52_V2_a.csv", 4.3, 1.5))
    assert found.mass == 0.052
    assert found.frequency == pytest.approx(4.3, rel=1e-3)
    assert found.decay == pytest.approx(1.5, rel=0.01)
    assert found.residual < 1e-3


def test_the_names_tell_the_mass() -> None:
    names = {"beam_gravity_V2_a.csv": 0.0, "beam_load52_V2_b.csv": 0.052, "beam_load101_V2_a.csv": 0.101}
    names |= {"beam_V2_Load_101.5_a.csv": 0.1015, "beam_load101g_V2.csv": 0.101}
    assert {name: foreign.tip_mass(Path(name)) for name in names} == names
    with pytest.raises(InputError, match="the name gives no load"):
        foreign.tip_mass(Path("beam_V2.csv"))


def test_a_beams_rate_is_close_to_bernoullis(monkeypatch: pytest.MonkeyPatch) -> None:
    """Without a mass, and with one far heavier than the beam, a spring 3 E I/L³; shear makes both softer."""
    monkeypatch.setattr(foreign, "MESHES", ((4, 1, 1), (8, 2, 2)))
    light, heavy = foreign.modal_rates([0.0, 10.0])
    width, length = 0.03, 0.1
    assert light == pytest.approx(3.516**2 * width**2 / 12 / (1070 * length**4), rel=0.15)
    assert heavy == pytest.approx(3 * width**4 / 12 / length**3 / (10 + 0.236 * 1070 * width**2 * length), rel=0.15)


def test_rates_extrapolated_from_two_meshes_are_those_of_a_finer_one(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(foreign, "MESHES", ((8, 2, 2), (12, 3, 3)))
    finer = foreign.mesh_rates([0.0, 0.101], (16, 4, 4))
    coarse = foreign.mesh_rates([0.0, 0.101], (12, 3, 3))
    left = foreign.modal_rates([0.0, 0.101]) - finer
    assert ((coarse - finer) / -left < 1.1).all()  # from 12 to 16 cells less than from 16 to none: 7/9 at second order
    np.testing.assert_allclose((coarse - finer) / -left, 7 / 9, atol=0.15)


def test_a_standard_linear_solid_rings_as_its_modulus_says() -> None:
    """Small loss: ω² = rate·E(1 + γω²τ²/(1 + ω²τ²)), decay = ω/2 × loss over storage."""
    small = 2e5, Relaxation(0.01, 0.03)
    frequency, decay = foreign.ringing_of(small, 0.008)
    turn = 2 * np.pi * frequency
    share = (turn * 0.03) ** 2 / (1 + (turn * 0.03) ** 2)
    assert turn**2 == pytest.approx(0.008 * 2e5 * (1 + 0.01 * share), rel=1e-4)
    assert decay == pytest.approx(turn / 2 * 0.01 * turn * 0.03 / (1 + (turn * 0.03) ** 2), rel=0.01)


def test_the_solid_is_found_and_the_kept_run_predicted(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(foreign, "MESHES", ((2, 1, 1), (4, 2, 2)))
    masses = (0.0, 0.052, 0.101)
    rates = dict(zip(masses, foreign.modal_rates(masses), strict=True))
    runs = {f"{mass}": foreign.Ringing(mass, *foreign.ringing_of(SOLID, rate), 0.0) for mass, rate in rates.items()}
    young, relaxation = foreign.fit_solid([runs["0.0"], runs["0.052"]], rates)
    assert young == pytest.approx(SOLID[0], rel=1e-3)
    assert relaxation.ratio == pytest.approx(SOLID[1].ratio, rel=0.01)
    found = foreign.judge_beams(runs)
    assert abs(found["0.101"]["frequency error"]) < 1e-3
    assert abs(found["0.101"]["decay error"]) < 0.01
    assert "predicted frequency (Hz)" not in found["0.052"]
    alone = foreign.judge_beams({"0.101": runs["0.101"]})
    assert alone["0.101"]["predicted from"] == "the fit that comes along"


def at_rest(path: Path) -> None:
    table = np.column_stack([np.arange(100), np.ones((100, 18))])
    np.savetxt(path, table, delimiter=",", header="t", comments="")


NO_FILE = r"beam_gravity.csv is no table of numbers \(no file but a pipe or a device\)"


@pytest.mark.parametrize(
    ("make", "said"),
    [
        (lambda path: path.write_text("t,a\n1,x\n"), "no table of numbers"),
        (lambda path: path.write_text("t,a\n1,2\n"), "has shape"),
        (lambda path: None, "no table"),
        (os.mkfifo, NO_FILE),
        (lambda path: path.symlink_to("/dev/zero"), NO_FILE),
        (at_rest, "ends where it began"),
    ],
)
def test_other_tables_are_refused(make: Callable[[Path], object], said: str, tmp_path: Path) -> None:
    make(tmp_path / "beam_gravity.csv")
    with pytest.raises(InputError, match=said):
        foreign.read_ringing(tmp_path / "beam_gravity.csv")


@pytest.mark.parametrize("rate", [0.0, -0.01, 1e-12])
def test_times_that_stand_still_or_run_backwards_are_told(rate: float, tmp_path: Path) -> None:
    path = write_beam(tmp_path / "beam_gravity.csv", 4.3, 1.5)
    table = np.loadtxt(path, delimiter=",", skiprows=1)
    table[:, 0] = rate * np.arange(len(table))
    np.savetxt(path, table, delimiter=",", header="t", comments="")
    if rate > 0:  # far beyond what the fit looks for
        assert foreign.read_ringing(path).frequency <= 40
        return
    with pytest.raises(InputError, match=r"beam_gravity.csv holds a time that is not after the one before; sort"):
        foreign.read_ringing(path)


def test_every_file_gets_its_rows(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    data = tmp_path / "data"
    write_beam(data / "beam" / "beam_gravity_a.csv", 7.7, 2.5)
    write_beam(data / "beam" / "beam_load52_a.csv", 4.3, 1.5)
    write_beam(data / "beam" / "beam_load101_a.csv", 3.3, 1.1)
    (data / "beam" / "beam_load20.csv").write_text("nothing")
    monkeypatch.setattr(foreign, "MESHES", ((4, 1, 1), (8, 2, 2)))
    assert foreign.main(["--data", str(data), "--output", str(tmp_path / "out")]) == 1
    found = read_measures(tmp_path / "out" / "table.csv")
    assert "beam_load20.csv" in found["beam/beam_load20.csv", "status"]
    assert abs(float(found["beam/beam_load101_a.csv", "frequency error"])) < 0.1
    assert ("beam, fitted together", "E (Pa)") in found


def test_nothing_known_is_wrong_usage(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit, match="2"):
        foreign.main(["--data", str(tmp_path), "--output", str(tmp_path / "out")])
    assert "holds no beam_" in capsys.readouterr().err


@pytest.mark.slow
def test_the_real_beams_stiffness_is_the_published_one(real_data: Path) -> None:
    runs = {path.name: foreign.read_ringing(path) for path in sorted((real_data / "silicone_beam").glob("beam_*.csv"))}
    found = foreign.judge_beams(runs)["beam, fitted together"]
    assert abs(found["E / published - 1"]) < 0.15
