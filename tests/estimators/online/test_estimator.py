"""`infer.py --estimator online` as a user runs it: fields of tissue that is pulled, and a sentence where none is."""

import hashlib
import json
from pathlib import Path

import cv2
import meshio
import numpy as np
import pytest
from scipy.stats import spearmanr

from palpate.command import infer
from palpate.data.masks.class_table import CLASSES
from palpate.estimators.online import driven
from palpate.estimators.online.objective import Chamfer
from tests.benchmarks.real_clips import pull_pictures, tissue_motion, tool_mask, write
from tests.conftest import CHECKOUT
from tests.tables import read_rows

pytestmark = pytest.mark.usefixtures("blank_module")
SHARES = np.linspace(0, 1, 6)
SETTINGS = "particles: 150\nstrain: 0.01\nfitted: 2\n"


def write_annotated(folder: Path, shares: np.ndarray, camera: tuple[float, float] = (0.0, 0.0)) -> Path:
    """A pull in CholecSeg8k's layout."""
    for number, (share, picture) in enumerate(zip(shares, pull_pictures(shares, camera), strict=True), start=10):
        tool = tool_mask(share)[..., None]
        colors = np.where(tool, CLASSES["grasper"].color, CLASSES["gallbladder"].color).astype(np.uint8)
        for name, image in (("", picture), ("_color_mask", colors)):
            write(folder / f"frame_{number}_endo{name}.png", cv2.cvtColor(image, cv2.COLOR_RGB2BGR))
    return folder


def run(folder: Path, *clips: Path, settings: str = SETTINGS, options: tuple[str, ...] = ("--no-overlay",)) -> int:
    """The exit status; results lie in the folder's `out`."""
    (folder / "online.yaml").write_text(settings)
    told = ["--estimator", "online", "--settings", str(folder / "online.yaml"), "--output", str(folder / "out")]
    return infer.main([*map(str, clips), *told, *options])


@pytest.fixture(scope="module")
def results(tmp_path_factory: pytest.TempPathFactory, blank_module: None) -> Path:
    """Of a clip where tissue is pulled while the camera moves, and of one where nothing moves."""
    folder = tmp_path_factory.mktemp("online")
    clips = [write_annotated(folder / "pulled", SHARES, (6.0, 0.0)), write_annotated(folder / "still", np.zeros(4))]
    assert run(folder, *clips, options=("--export",)) == 0
    return folder / "out"


def test_the_last_frame_s_field_is_exported_where_the_motion_is_explained(results: Path) -> None:
    files = sorted((results / "pulled").glob("scene_10_*.vtu"))
    read = meshio.read(files[-1])
    with np.load(results / "pulled" / "fields.npz", allow_pickle=False) as fields:
        np.testing.assert_allclose(read.point_data["stiffness"][:, 0], fields["frame_15/distance"], rtol=1e-6)
        np.testing.assert_array_equal(read.point_data["stiffness_known"], fields["frame_15/known"])
    assert len(files) == len(SHARES) - 1
    assert not list((results / "still").glob("scene*"))


def test_every_frame_in_contact_has_a_field(results: Path) -> None:
    table = read_rows(results / "pulled" / "parameters.csv")
    assert [row["status"] for row in table] == ["ok"] * len(SHARES)
    with np.load(results / "pulled" / "fields.npz", allow_pickle=False) as fields:
        for row in table:
            part = f"frame_{row['frame']}/"
            known, distance = fields[part + "known"], fields[part + "distance"]
            assert fields[part + "run"] == 10
            assert float(row["field_known"]) == pytest.approx(known.mean(), rel=1e-5)
            assert (row["distance_stiffness"] != "") == known.any()
            if known.any():
                assert float(row["distance_stiffness"]) == pytest.approx(np.median(distance[known]), rel=1e-5)
            assert row["verdict"] == ("stiffness_ratios" if known.any() else "undetermined")
        assert table[0]["skill"] == ""
        assert float(table[-1]["skill"]) > 0.35
        assert np.isfinite(fields["frame_15/distance_log_sd"]).all()
        # No sheet moves as this tissue does, which is drawn by a formula: any field explains it as well.
        assert not fields["frame_15/known"].any()
        assert all(row["stiffness"] == row["force"] == "" for row in table)


def test_particles_are_drawn_where_their_tissue_is(results: Path) -> None:
    """The camera's motion, which the state doesn't have, included."""
    with np.load(results / "pulled" / "fields.npz", allow_pickle=False) as fields:
        first, last = fields["frame_10/pixels"], fields["frame_15/pixels"]
        here, there = fields["frame_10/positions"], fields["frame_15/positions"]
    inner = (first > 24).all(axis=1) & (first[:, 0] < 216) & (first[:, 1] < 152)
    away = inner & (np.linalg.norm(tissue_motion(first, 1.0), axis=1) < 0.8)
    assert away.sum() > 5
    np.testing.assert_allclose(np.median((last - first)[away], axis=0), [6.0, 0.0], atol=1.0)
    pixel = np.ptp(here[:, 0]) / np.ptp(first[:, 0])
    assert np.median(np.linalg.norm((there - here)[away], axis=1)) < 1.5 * pixel


def test_a_run_says_what_is_explained_and_that_theta_is_not_told(results: Path) -> None:
    (row,) = read_rows(results / "pulled" / "interactions.csv")
    assert (row["onset_frame"], row["status"], row["verdict"]) == ("10", "ok", "undetermined")
    assert float(row["skill"]) > 0.35
    assert "sheet of one number predicts later frames from earlier ones better" in row["explanation"]
    assert "Relative stiffness place by place (fields.npz)" in row["detail"]
    assert "Fitted to the first frames: steps of" in row["detail"]
    record = json.loads((results / "pulled" / "run.json").read_text())
    assert "relative" in record["units"]["distance_stiffness"]
    assert record["estimator"]["particles"] == 150
    assert not any("stretch" in warning for warning in record["warnings"])
    assert record["contacts"] == {"undetermined": 1}


def test_a_clip_without_a_driving_tool_says_so_in_a_sentence(results: Path) -> None:
    record = json.loads((results / "still" / "run.json").read_text())
    (warning,) = [each for each in record["warnings"] if "stretch" in each]
    assert "the online estimator needs a clip whose tool drives the tissue" in warning
    assert {row["distance_stiffness"] for row in read_rows(results / "still" / "parameters.csv")} == {""}


GIVEN = "particles: 150\nbackground: keep\nthickness: 0.05\npins: pins.png\npath: given/path.csv\n"
PINNED = 190
"""Column from which the mask is white [px]."""


def test_an_invented_path_is_no_field_and_a_warning(tmp_path: Path, capsys: pytest.CaptureFixture) -> None:
    """The gripper is told to go the other way than the tissue does: nothing is told or coloured of what that learns."""
    write_given(tmp_path, "0,50,60,0.3\n0.2,70,48,0.3\n")
    settings = "background: keep\npath: given/path.csv\n" + SETTINGS
    assert run(tmp_path, write_annotated(tmp_path / "clip", SHARES), settings=settings) == 0
    said = " ".join(capsys.readouterr().err.split())
    assert "contact from frame 10: The fit does not explain the motion: tissue simulated under the instrument" in said
    (row,) = read_rows(tmp_path / "out" / "clip" / "interactions.csv")
    assert (row["status"], row["verdict"]) == ("ok", "undetermined")
    assert float(row["skill"]) < 0.35
    table = read_rows(tmp_path / "out" / "clip" / "parameters.csv")
    assert {(each["distance_stiffness"], each["field_known"]) for each in table} == {("", "0")}


def write_given(folder: Path, rows_told: str = "0,50,60,0.3\n0.2,40,66,0.28\n") -> None:
    """A mask and a path for settings beside them."""
    mask = np.zeros(tool_mask(0).shape, np.uint8)
    mask[:, PINNED:] = 255
    write(folder / "pins.png", mask)
    (folder / "given").mkdir()
    (folder / "given" / "path.csv").write_text(f"time_s,x_px,y_px,z\n{rows_told}")


@pytest.fixture(scope="module")
def given(tmp_path_factory: pytest.TempPathFactory, blank_module: None) -> Path:
    """Results of a volume whose pins and gripper are given."""
    folder = tmp_path_factory.mktemp("given")
    write_given(folder)
    assert run(folder, write_annotated(folder / "pulled", SHARES), settings=GIVEN) == 0
    return folder / "out"


def test_a_volume_moves_with_the_path_of_its_gripper_and_keeps_its_pins(given: Path) -> None:
    with np.load(given / "pulled" / "fields.npz", allow_pickle=False) as fields:
        rest, faces = (fields[f"run_10/{name}"] for name in ("rest", "faces"))
        states, pixels = (
            np.array([fields[f"frame_{number}/{name}"] for number in range(10, 16)], np.float64)
            for name in ("positions", "pixels")
        )
    rest, upper = rest.astype(np.float64), np.unique(faces)
    assert len(rest) >= 2 * len(upper)
    gripped = upper[np.linalg.norm(pixels[0][upper] - (50, 60), axis=1) < 24]
    assert len(gripped) >= 2
    way = np.broadcast_to(SHARES[:, None, None] * [-10, 6], (len(SHARES), len(gripped), 2))
    np.testing.assert_allclose((pixels - pixels[0])[:, gripped], way, atol=0.01)
    nearer = np.tile(-0.02 * SHARES[:, None], len(gripped))
    np.testing.assert_allclose((states - rest)[:, gripped, 2], nearer, atol=1e-6)
    pinned = np.tile(pixels[0][upper, 0] > PINNED, len(rest) // len(upper))
    assert pinned.any()
    np.testing.assert_array_equal(states[-1][pinned], rest[pinned])
    assert (np.linalg.norm(states[-1] - rest, axis=1)[~pinned] > 1e-6).mean() > 0.9


def test_what_was_given_is_told_with_the_results(given: Path) -> None:
    record = json.loads((given / "pulled" / "run.json").read_text())["estimator"]
    assert record["thickness"] == 0.05
    for name, file in (("pins", given.parent / "pins.png"), ("path", given.parent / "given" / "path.csv")):
        assert record[name] == {"path": str(file), "sha256": hashlib.sha256(file.read_bytes()).hexdigest()}


def test_a_mask_of_another_size_ends_one_clip_of_the_batch(tmp_path: Path, capsys: pytest.CaptureFixture) -> None:
    write_given(tmp_path)
    clips = [write_annotated(tmp_path / name, np.zeros(2)) for name in ("narrow", "wide")]
    for path in clips[0].iterdir():
        write(path, cv2.imread(str(path))[:, :-16])
    assert run(tmp_path, *clips, settings=GIVEN) == 1
    said = "pins.png is 240x176, the clip's pictures are 224x176; give a mask of the size of the clip's pictures."
    assert said in " ".join(capsys.readouterr().err.split())
    assert (tmp_path / "out" / "wide" / "run.json").exists()
    assert not (tmp_path / "out" / "narrow").exists()


def test_clouds_are_compared_with_the_surface_of_a_volume(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Every particle of it that no tool hides, and none below."""
    shown: list[np.ndarray] = []

    def chamfer(cloud: np.ndarray, seen: np.ndarray) -> Chamfer:
        shown.append(seen)
        return Chamfer(cloud, seen)

    monkeypatch.setattr(driven, "Chamfer", chamfer)
    settings = "particles: 150\nthickness: 0.05\nmatch: chamfer\nbackground: keep\nfitted: 0\n"
    assert run(tmp_path, write_annotated(tmp_path / "clip", SHARES[:3]), settings=settings) == 0
    with np.load(tmp_path / "out" / "clip" / "fields.npz", allow_pickle=False) as fields:
        upper, count = np.unique(fields["run_10/faces"]), len(fields["run_10/rest"])
    assert len(shown) == 2
    assert len(upper) <= count / 2
    for seen in shown:
        assert np.isin(seen, upper).all()
        assert len(seen) > 0.9 * len(upper)


@pytest.mark.parametrize(
    ("rows_told", "status", "sentence"),
    [
        ("0,50,60,1\n", 2, "path.csv has 1 rows; give a CSV file with the columns time_s, x_px, y_px, z"),
        ("0,50,60,300\n0.2,50,60,280\n", 1, "path.csv takes tissue behind the camera by 0.04 s; give z in scene units"),
        ("0,2,900,1\n0.2,2,900,1\n", 0, "px away from all tissue in frame 10, when contact begins; give the gripper"),
        ("0.1,50,60,1\n0.2,50,60,1\n", 0, "path.csv tells no place at 0 s, when contact begins in frame 10; give rows"),
    ],
)
def test_a_path_that_can_t_be_used_is_a_sentence(tmp_path, capsys, rows_told, status, sentence) -> None:
    """A broken file before anything; one that a clip can't follow with that clip; one that begins late with its run."""
    write_given(tmp_path, rows_told)
    assert run(tmp_path, write_annotated(tmp_path / "clip", SHARES[:2]), settings=GIVEN) == status
    said = " ".join(capsys.readouterr().err.split())
    if status == 0:
        said = read_rows(tmp_path / "out" / "clip" / "interactions.csv")[0]["detail"]
    assert sentence in said


@pytest.mark.slow
def test_a_real_pull_is_explained_and_both_optimisers_colour_only_what_they_agree_on(real_data, tmp_path, capsys):
    """Where tissue has stretched their maps rank as 0.1."""
    layout = str(CHECKOUT / "configs/layouts/recover_tissue.yaml")
    found = []
    for optimizer in ("adam", "gauss-newton"):
        settings, output = f"particles: 600\nmethod: {{optimizer: {optimizer}}}\n", tmp_path / optimizer
        options = "--layout", layout, "--output", str(output), "--no-overlay"
        assert run(tmp_path, real_data / "recover_tissue", settings=settings, options=options) == 0
        (row,) = read_rows(output / "recover_tissue" / "interactions.csv")
        assert row["status"] == "ok"
        assert float(row["skill"]) > 0.35
        said = " ".join(capsys.readouterr().err.split())
        unsure = "no place's stiffness is determined" in said or "where it is stiffer is not determined" in said
        assert unsure == (row["verdict"] == "undetermined")
        with np.load(output / "recover_tissue" / "fields.npz", allow_pickle=False) as fields:
            found.append((fields["frame_20/distance"], fields["frame_20/known"]))
    (one, first), (other, second) = found
    both = first & second
    assert both.sum() < 3 or spearmanr(one[both], other[both])[0] > 0.7
    assert first.mean() < 0.3
