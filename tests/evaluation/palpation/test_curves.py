"""Every table is judged that is known by its columns, whatever its name, and one bad file costs its own rows."""

from pathlib import Path

from palpate.evaluation.palpation import __main__ as door
from tests.estimators.palpation.test_region import probes
from tests.estimators.palpation.test_relaxation import ramp_and_hold
from tests.tables import read_measures


def write_probes(path: Path) -> None:
    rows = ["probe,step,contact_x,contact_y,contact_z,depth_mm,fn_N"]
    for probe in probes(40, 0.01, 2):
        x, y, z = probe.place
        pairs = zip(probe.depth, probe.force, strict=True)
        rows += [f"{probe.name},{step},{x},{y},{z},{d},{f}" for step, (d, f) in enumerate(pairs)]
    path.write_text("\n".join(rows))


def write_hold(path: Path) -> None:
    hold = ramp_and_hold(1.0, 2.0)
    rows = zip(hold.times, hold.force, hold.depth, strict=True)
    path.write_text("t_s,force_N,displacement_mm\n" + "\n".join(f"{t},{f},{d}" for t, f, d in rows))


def test_every_known_table_gets_its_rows(tmp_path: Path) -> None:
    data = tmp_path / "data"
    (data / "deeper").mkdir(parents=True)
    write_probes(data / "whatever.csv")
    write_hold(data / "deeper" / "some name.CSV")
    (data / "bad.csv").write_text("t_s,force_N,displacement_mm\n1,2\n")
    (data / "foreign.csv").write_text("a,b\n1,2\n")
    assert door.main(["curves", "--data", str(data), "--output", str(tmp_path / "out")]) == 1
    found = read_measures(tmp_path / "out" / "table.csv")
    assert float(found["whatever.csv", "that over the mean stiffness's, random fifths"]) < 0.5
    assert float(found["deeper/some name.CSV", "second half off, rms / peak"]) < 0.05
    assert "bad.csv" in found["bad.csv", "status"]
    assert "foreign.csv" not in {name for name, _ in found}
