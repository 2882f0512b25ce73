"""Kilopascals of a field: how often the intervals hold on drawn pulls of known E, and what tells none."""

import dataclasses
from pathlib import Path
from types import SimpleNamespace
from typing import cast

import numpy as np
import pytest

from palpate.estimators.estimate import NINETY
from palpate.estimators.online.determined import Determined
from palpate.estimators.online.driven import DrivenTissue
from palpate.estimators.online.kilopascals import Kilopascals
from palpate.estimators.online.particle_field import FieldEstimate
from palpate.results.overlay import _described_field
from tests.benchmarks.real_clips import SIZE, write
from tests.estimators.online.pulls import by_palpation, draw_pull, holds
from tests.estimators.online.pulls import followed as followed_pull
from tests.estimators.online.test_estimator import SETTINGS, SHARES, run, write_annotated
from tests.results.fields import FIELD_SEEN
from tests.tables import read_rows


@pytest.mark.slow
def test_nine_of_ten_intervals_hold_on_drawn_pulls(tmp_path: Path) -> None:
    """Seeds that nothing was chosen by. The stiff part by itself, too, which is what a field finds last."""
    held: dict[str, list[list[np.ndarray]]] = {"force": [], "palpation": []}
    for seed in range(983001, 983013):
        pull = draw_pull(seed, tmp_path / str(seed))
        field, driven = followed_pull(pull.path, "gauss-newton", 0)
        true, told = pull.young(field), field.young
        stiff = true > 1.5 * pull.soft
        for how, young in (("force", told), ("palpation", by_palpation(pull, field, driven))):
            if young is not None:
                held[how].append([holds(true, young), holds(true[stiff], young[:, stiff])])
        if told is not None:
            assert not np.isfinite(told[0, ~field.known]).any()  # unknown stays unknown
    for how, pulls in held.items():
        every, stiff = (np.concatenate(part) for part in zip(*pulls, strict=True))
        print(how, len(every), every.mean(), stiff.mean())
        assert len(every) > 100
        assert every.mean() >= 0.8
        assert stiff.mean() >= 0.8


@pytest.fixture(scope="module")
def clip(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a pull whose depth is stored, a camera that tells its unit, 0.2 m, forces and a palpation."""
    folder = tmp_path_factory.mktemp("metric")
    write_annotated(folder / "clip", SHARES)
    width, height = SIZE
    for number in range(10, 10 + len(SHARES)):
        depth = np.tile(np.linspace(30000, 34000, width).astype(np.uint16), (height, 1))
        write(folder / f"clip/frame_{number}_endo_depth.png", depth)
    camera = f"fx: 300\nfy: 300\ncx: {width / 2}\ncy: {height / 2}\nwidth: {width}\nheight: {height}\n"
    for name, unit in (("camera", "metres_per_depth: 0.2"), ("longer", "metres_per_depth: 0.4"), ("unknown", "")):
        (folder / f"{name}.yaml").write_text(camera + unit)
    for name, newtons in (("forces", 1.0), ("twice", 2.0)):
        (folder / f"{name}.csv").write_text(f"time_s,force_N\n0,0\n0.1,{newtons / 2}\n0.2,{newtons}\n")
    (folder / "e.json").write_text('{"young_pa": 2300, "young_low_pa": 2000, "young_high_pa": 2645}')
    return folder


@pytest.fixture
def all_known(monkeypatch: pytest.MonkeyPatch) -> None:
    """As if all tissue that has stretched were determined, and a sheet predicted worse: neither is so here."""
    known = lambda self, fields, among: (np.full((2, len(among)), 0.1), np.stack([among, among]))  # noqa: E731
    monkeypatch.setattr(Determined, "known", known)
    monkeypatch.setattr(FieldEstimate, "simpler", False)


def followed(folder: Path, *more: str, settings: str, camera: str = "camera") -> tuple[dict[str, str], dict, str]:
    """The last frame's row, its field, and what is said of the run."""
    options = "--camera", str(folder / f"{camera}.yaml"), "--no-overlay", "--overwrite", *more
    assert (
        run(
            folder,
            folder / "clip",
            settings=SETTINGS.replace("fitted: 2", "fitted: 0") + settings,
            options=options,
        )
        == 0
    )
    with np.load(folder / "out/clip/fields.npz") as file:
        field = {name: file[name] for name in file.files if "frame_15" in name or "frame_10/pixels" in name}
    return (
        read_rows(folder / "out/clip/parameters.csv")[-1],
        {name.removeprefix("frame_15/"): values for name, values in field.items()},
        read_rows(folder / "out/clip/interactions.csv")[0]["detail"],
    )


@pytest.mark.usefixtures("all_known", "blank_module")
def test_a_known_force_and_a_metric_clip_tell_kilopascals_on_video(clip: Path) -> None:
    forces = "--force-scale", str(clip / "forces.csv")
    row, field, said = followed(clip, *forces, settings="sheet_m: 0.002\n")
    young, low, high = (field[f"young_kPa{end}"] for end in ("", "_low", "_high"))
    known = field["known"]
    assert f"determined E is {np.median(young[known]):.3g} kPa ({np.median(low[known]):.3g} to" in said
    np.testing.assert_array_equal(np.isfinite(young), known)
    assert float(row["young_kPa"]) == pytest.approx(np.median(young[known]), rel=1e-5)
    assert float(row["young_kPa_high"]) == pytest.approx(np.median(high[known]), rel=1e-5)
    stiffness = (field["distance"] + 3 * field["shape"])[known]
    np.testing.assert_allclose(young[known] / stiffness, young[known][0] / stiffness[0], rtol=1e-4)
    np.testing.assert_allclose((high / young)[known], (young / low)[known], rtol=1e-4)
    for options, more, factor in (
        (("--force-scale", str(clip / "twice.csv")), {}, 2),
        (forces, {"camera": "longer"}, 0.5),
        (forces, {"settings": "sheet_m: 0.004\n"}, 0.5),
    ):
        other = followed(clip, *options, **{"settings": "sheet_m: 0.002\n", **more})[1]["young_kPa"]
        np.testing.assert_allclose(other[known], factor * young[known], rtol=1e-4)
    row, field, _ = followed(clip, *forces, settings="sheet_m: 0.002\n", camera="unknown")
    assert "young_kPa" not in field
    assert (row["young_kPa"], row["young_kPa_low"], row["young_kPa_high"]) == ("", "", "")


@pytest.mark.usefixtures("all_known", "blank_module")
def test_a_palpation_at_a_pixel_tells_kilopascals_on_video(clip: Path) -> None:
    row, field, _ = followed(clip, settings="", camera="unknown")
    assert row["young_kPa"] == ""  # relative where nothing is told
    at = int(np.flatnonzero(field["known"])[0])
    column, line = field["frame_10/pixels"][at]
    told = f"palpation: e.json\npalpated_at: [{column}, {line}]\n"
    row, field, _ = followed(clip, settings=told, camera="unknown")
    assert field["young_kPa"][at] == pytest.approx(2.3, rel=1e-5)
    e_sd = np.log(2645 / 2000) / 2 / NINETY
    weights = np.array([field["distance"][at], 3 * field["shape"][at]])
    own = 0.1 * np.linalg.norm(weights) / weights.sum()
    expected = np.exp(NINETY * np.sqrt(2 * own**2 + e_sd**2))
    assert field["young_kPa_high"][at] / field["young_kPa"][at] == pytest.approx(expected, rel=1e-4)
    row, field, _ = followed(clip, settings="palpation: e.json\npalpated_at: [-90, 10]\n", camera="unknown")
    assert row["young_kPa"] == ""


@pytest.mark.usefixtures("blank_module")
def test_a_field_that_is_not_determined_has_no_kilopascals(clip: Path) -> None:
    row, field, said = followed(clip, "--force-scale", str(clip / "forces.csv"), settings="sheet_m: 0.002\n")
    assert (row["young_kPa"], row["field_known"]) == ("", "0")
    assert "kilopascals" not in said
    assert "young_kPa" not in field


@pytest.mark.parametrize(
    ("settings", "options", "sentence"),
    [
        (
            SETTINGS,
            ("--force-scale", "forces.csv"),
            "--force-scale and sheet_m in --settings give kPa of online together",
        ),
        ("sheet_m: 0.002\n", (), "--force-scale and sheet_m in --settings give kPa of online together"),
        ("sheet_m: 0.002\nthickness: 0.1\n", (), "sheet_m is for a sheet of which no palpation tells kilopascals"),
        ("palpation: e.json\n", (), "palpation and palpated_at belong together; give both"),
        ("palpation: no.json\npalpated_at: [5, 5]\n", (), "no.json"),
        ("sheet_m: -1\n", (), "sheet_m"),
    ],
)
def test_what_tells_no_kilopascals_is_refused(clip: Path, capsys, settings: str, options, sentence: str) -> None:
    given = [str(clip / each) if each.endswith(".csv") else each for each in options]
    assert run(clip, clip / "clip", settings=settings, options=("--no-overlay", *given)) == 2
    assert sentence in " ".join(capsys.readouterr().err.split())


def test_reasons_and_legend() -> None:
    """Of a field: why forces tell nothing yet, and what the picture says where they do."""
    surface = SimpleNamespace(gripped=np.array([0]))
    kilopascals = Kilopascals(cast(DrivenTissue, SimpleNamespace(surface=surface)), 0.002)
    assert kilopascals.anchored(FIELD_SEEN).young is None
    assert kilopascals.said == "No kilopascals: the force is known in 0 frames by now, and 3 are needed."
    kilopascals.anchored(FIELD_SEEN, None)
    assert "nothing tells how long a scene unit is" in kilopascals.said
    kilopascals.anchored(dataclasses.replace(FIELD_SEEN, known=np.zeros(4, bool)))
    assert kilopascals.said == ""
    palpated = Kilopascals(cast(DrivenTissue, SimpleNamespace(surface=surface)), (4000, 0.0, 3))
    palpated.anchored(FIELD_SEEN)
    assert palpated.said == "No kilopascals: stiffness is not determined where the tissue was palpated."
    found = Kilopascals(cast(DrivenTissue, SimpleNamespace(surface=surface)), (4000, 0.0, 0)).anchored(FIELD_SEEN)
    assert "the median is 4 kPa (" in _described_field(found)
    assert "relative units" in _described_field(FIELD_SEEN)
