"""The door estimate.py: what it writes about every contact, what it says where there is none, and how it ends."""

from __future__ import annotations

import csv
import json
import shutil
import subprocess
import sys
from pathlib import Path

import cv2
import numpy as np
import pytest

import estimate
import infer
from data.contact_motion import FRAYED
from data.synthetic import write_clip as write_synthetic
from data.synthetic_settings import SceneSettings
from estimators.estimate import NINETY
from evaluation.contact_results import COLUMNS
from tests.inference_inputs import write_clip, write_model
from tests.test_architecture import NOT_AT_INFERENCE, ROOT

SCENE = SceneSettings(
    width=214,
    height=120,
    frames=22,
    onset_fraction=(0.15, 0.2),
    press_seconds=(0.3, 0.3),
    stiffness=(0.4, 0.4),
    damping=(0.03, 0.03),
    force=(-0.05, -0.05),
    depth_noise=0.0005,
)
BANNED = tuple(name for name in NOT_AT_INFERENCE if name != "scipy.stats")  # Sobol points come from there
FILES = ["contacts.csv", "fit.png", "run.json"]


@pytest.fixture(scope="module")
def clips(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with one synthetic clip of known truth as a folder of frames."""
    folder = write_synthetic(tmp_path_factory.mktemp("clips"), 1, SCENE, 3)
    folder.with_suffix(".mp4").unlink()
    return folder.parent


@pytest.fixture(scope="module")
def done(clips: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Results of that clip."""
    output = tmp_path_factory.mktemp("results")
    assert call(clips, output) == 0
    return output / "video01_00000"


def call(clips: Path, output: Path, *options: str) -> int:
    """Synthetic presses begin at a frame's time stamp."""
    return estimate.main(["direct", str(clips), "--output", str(output), "--onset", "stamp", *options])


def rows(folder: Path) -> list[dict[str, str]]:
    with (folder / "contacts.csv").open(encoding="utf-8", newline="") as stream:
        return list(csv.DictReader(stream))


def record(folder: Path) -> dict:
    return json.loads((folder / "run.json").read_text(encoding="utf-8"))


def flat(text: str) -> str:
    return " ".join(text.split())


def test_a_contact_with_known_truth_is_recovered_within_its_uncertainty(done: Path, clips: Path) -> None:
    assert sorted(path.name for path in done.iterdir()) == FILES
    (row,) = rows(done)
    truth = json.loads((clips / "video01_00000" / "truth.json").read_text(encoding="utf-8"))
    assert list(row) == list(COLUMNS)
    assert (row["status"], row["verdict"], row["detail"], row["at_bound"]) == ("ok", "determined", "", "")
    assert float(row["onset_time_s"]) == pytest.approx(truth["onset_s"])
    assert int(row["onset_frame"]) == round(truth["onset_s"] * 25)
    assert float(row["load_s"]) == pytest.approx(truth["release_s"] - truth["onset_s"])
    for name, value in truth["theta"].items():
        found, sd, bound = (float(row[f"{name}{suffix}"]) for suffix in ("", "_sd", "_bound"))
        assert found > 0
        assert abs(found - abs(value)) < 4 * sd
        assert abs(np.log(found / abs(value))) < 0.25
        assert sd == pytest.approx(bound * found, rel=0.2)  # the bound is the largest within one sd
        low, high = (float(row[f"{name}_{end}"]) for end in ("low", "high"))
        assert low < found < high
        assert np.log(high / low) / 2 == pytest.approx(NINETY * sd / found, rel=0.05)
    # The noise is what was put in, and the relief that a plane around every pixel leaves.
    assert 0.9 * SCENE.depth_noise < float(row["noise"]) < 1.3 * SCENE.depth_noise
    assert 0.3 < float(row["misfit"]) < 1.5
    assert "determined" in row["explanation"]


def test_real_presses_begin_between_frames(done: Path, clips: Path, tmp_path: Path) -> None:
    """Unless told otherwise; an estimate is less certain then."""
    assert estimate.main(["direct", str(clips), "--output", str(tmp_path)]) == 0
    ((exact,), (between,)) = rows(done), rows(tmp_path / "video01_00000")
    for name in ("stiffness", "damping", "force"):
        widths = [np.log(float(row[f"{name}_high"]) / float(row[f"{name}_low"])) for row in (exact, between)]
        assert widths[1] > 1.1 * widths[0]
    assert exact["delay_s"] == ""
    assert abs(float(between["delay_s"])) < 0.01  # it began at the stamp, and the fit finds that
    assert between["verdict"] == "determined"
    told = [record(folder)["estimator"]["onset"] for folder in (done, tmp_path / "video01_00000")]
    assert told == ["stamp", "between"]
    within = [record(folder)["estimator"]["onset_within"] for folder in (done, tmp_path / "video01_00000")]
    assert within == [0.0, pytest.approx(0.04)]


def test_record_says_what_was_done(done: Path) -> None:
    found = record(done)
    assert found["program"] == "estimate.py"
    assert found["estimator"]["name"] == "direct"
    assert found["estimator"]["stiffness"] == [0.05, 1.0]
    assert found["settings"]["geometry"]["smoothing"] == 4.0
    assert found["settings"]["geometry"]["rigid_motion"] == "subtract"
    assert found["contacts"] == {"determined": 1}
    assert sum(found["statuses"].values()) == found["input"]["frames"] == 22
    assert found["units"]["stiffness"] == "scene units (normalised), not N/m"
    assert found["notice"] == "Research software, not a medical device."
    assert set(found["columns"]) == set(COLUMNS)
    assert {"decode", "geometry", "tracking", "fit", "total"} <= set(found["timings_s"])
    assert found["warnings"] == []


def test_the_picture_shows_observation_and_fit(done: Path) -> None:
    picture = cv2.imread(str(done / "fit.png"))[..., ::-1]
    assert picture.shape[1] == 1500
    for color in ((75, 85, 99), (124, 58, 237), (234, 88, 12)):
        assert (picture == color).all(axis=2).sum() > 100


def test_finished_clips_are_not_computed_again(done: Path, clips: Path, capsys: pytest.CaptureFixture) -> None:
    before = (done / "run.json").stat().st_mtime_ns
    assert call(clips, done.parent) == 0
    told = capsys.readouterr()
    assert "up to date" in told.err
    assert "1 determined" in told.out
    assert (done / "run.json").stat().st_mtime_ns == before


def test_without_a_noise_level_the_options_that_give_one_are_named(clips: Path, tmp_path: Path) -> None:
    assert call(clips, tmp_path, "--smoothing", "0") == 0
    (row,) = rows(tmp_path / "video01_00000")
    assert row["status"] == "no_estimate"
    assert row["detail"] == "The depth's noise isn't known; set --smoothing above 0, or give --noise."
    assert {row[name] for name in COLUMNS if name.startswith(("stiff", "damp", "force", "verd", "misf"))} == {""}
    assert int(row["frames"]) > 10
    # A noise of one's own makes another result of it.
    assert call(clips, tmp_path, "--smoothing", "4", "--noise", "0.002") == 0
    (row,) = rows(tmp_path / "video01_00000")
    assert (row["status"], row["noise"]) == ("ok", "0.002")


def test_a_clip_without_contact_gets_an_empty_table_and_says_so(tmp_path: Path, capsys: pytest.CaptureFixture) -> None:
    write_clip(tmp_path / "clip", 4, 9)
    assert call(tmp_path / "clip", tmp_path / "out") == 0
    assert rows(tmp_path / "out" / "clip") == []
    sentence = "no contact was found, so there is nothing to fit (4 no_tool)"
    assert record(tmp_path / "out" / "clip")["warnings"] == [sentence]
    assert f"clip: {sentence}" in capsys.readouterr().err
    assert cv2.imread(str(tmp_path / "out" / "clip" / "fit.png")).shape[1] == 1500


def test_contact_from_the_first_frame_on_has_no_estimate(tmp_path: Path) -> None:
    write_clip(tmp_path / "clip", 4, 0)
    assert call(tmp_path / "clip", tmp_path / "out") == 0
    (row,) = rows(tmp_path / "out" / "clip")
    assert (row["onset_frame"], row["frames"], row["load_s"], row["stiffness"]) == ("10", "0", "", "")
    assert row["status"] == "no_estimate"
    assert row["detail"].startswith("The onset of the contact was not seen")
    assert record(tmp_path / "out" / "clip")["contacts"] == {"no_estimate": 1}


@pytest.mark.parametrize(
    ("seen", "reason"),
    [
        (0, "The tissue at the contact could not be followed after its onset."),
        (2, "The contact was followed over 2 frames after its onset; 3 are needed."),
    ],
)
def test_what_is_wrong_with_a_contact_is_told_beside_the_reason_for_no_estimate(
    seen: int, reason: str, clips: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The clip ends `seen` frames after the onset, and its outlines disagree with its depth."""
    folder = shutil.copytree(clips / "video01_00000", tmp_path / "clip")
    onset = json.loads((folder / "truth.json").read_text(encoding="utf-8"))["onset_frame"]
    for path in folder.glob("frame_*"):
        if int(path.name.split("_")[1]) > onset + seen:
            path.unlink()
    layout = json.loads((folder / "clip.json").read_text(encoding="utf-8"))
    layout["times"] = layout["times"][: onset + seen + 1]
    (folder / "clip.json").write_text(json.dumps(layout), encoding="utf-8")
    monkeypatch.setattr("data.contact_motion.frayed_share", lambda *_: 0.25)
    assert call(folder, tmp_path / "out") == 0
    (row,) = rows(tmp_path / "out" / "clip")
    assert (row["onset_frame"], row["frames"], row["status"]) == (str(onset), str(seen), "no_estimate")
    assert row["detail"] == f"{FRAYED.format(share=0.25)} {reason}"


def test_one_failing_clip_does_not_stop_the_others(tmp_path: Path, capsys: pytest.CaptureFixture) -> None:
    write_clip(tmp_path / "clips" / "fine", 4, 9)
    (tmp_path / "clips" / "broken.mp4").write_bytes(b"no video")
    assert call(tmp_path / "clips", tmp_path / "out") == 1
    assert [path.name for path in (tmp_path / "out").iterdir()] == ["fine"]
    told = capsys.readouterr()
    assert "broken.mp4" in told.err
    assert "failed" in told.out


def test_wrong_usage(tmp_path: Path, capsys: pytest.CaptureFixture) -> None:
    (tmp_path / "empty").mkdir()
    assert call(tmp_path / "absent", tmp_path / "out") == 2
    assert "absent can't be opened" in flat(capsys.readouterr().err)
    assert call(tmp_path / "empty", tmp_path / "out") == 2
    assert "holds neither a video nor a folder of frames" in flat(capsys.readouterr().err)
    assert call(tmp_path / "empty", tmp_path / "out", "--depth", "nonsense") == 2
    assert "estimate.py: 'nonsense' is no depth preset" in flat(capsys.readouterr().err)
    for options in (["--noise", "0"], ["--noise", "much"], ["--smoothing", "-1"], ["--smoothing", "inf"]):
        with pytest.raises(SystemExit) as ended:
            call(tmp_path, tmp_path / "out", *options)
        assert ended.value.code == 2
        assert f"'{options[1]}' is not a" in capsys.readouterr().err
    with pytest.raises(SystemExit) as ended:
        estimate.main([])
    assert ended.value.code == 2


@pytest.mark.parametrize("noise", ["0", "1e-300", "1e-12", "2.9e-5", "-0.001", "nan", "inf"])
def test_a_noise_below_the_simulators_own_error_is_wrong_usage(
    noise: str, tmp_path: Path, capsys: pytest.CaptureFixture
) -> None:
    """Smaller ones ended in numpy's complaint about infinite numbers, or in certainty of 1e-7."""
    with pytest.raises(SystemExit) as ended:
        call(tmp_path, tmp_path / "out", f"--noise={noise}")
    assert ended.value.code == 2
    told = flat(capsys.readouterr().err)
    assert f"'{noise}' is not a noise above the simulator's own error; give 3e-05 or more" in told
    assert "Traceback" not in told


def test_results_of_infer_are_left_alone(tmp_path: Path) -> None:
    write_clip(tmp_path / "clip", 4, 9)
    write_model(tmp_path / "parameters.onnx")
    output = ["--output", str(tmp_path / "out")]
    assert (
        infer.main([str(tmp_path / "clip"), *output, "--model", str(tmp_path / "parameters.onnx"), "--no-overlay"]) == 0
    )
    for _ in range(2):
        assert estimate.main(["direct", str(tmp_path / "clip"), *output]) == 0
    folders = sorted((tmp_path / "out").iterdir())
    assert folders[0].name == "clip"
    assert (folders[0] / "parameters.csv").is_file()
    assert [sorted(path.name for path in folder.iterdir()) for folder in folders[1:]] == [FILES]


def test_interruption_leaves_nothing_half_written(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture
) -> None:
    def interrupt(*_: object) -> None:
        raise KeyboardInterrupt

    write_clip(tmp_path / "clip", 4, 9)
    monkeypatch.setattr("evaluation.contact_results.write_summary", interrupt)
    assert call(tmp_path / "clip", tmp_path / "out") == 130
    assert list((tmp_path / "out").iterdir()) == []
    assert "0 of 1 clips are complete" in capsys.readouterr().err


def test_it_runs_where_torch_cannot_be_imported(clips: Path, tmp_path: Path) -> None:
    """A whole run, fit included, with every training library made impossible to import, in a process of its own."""
    shutil.copytree(clips / "video01_00000", tmp_path / "clip")
    program = f"""
import sys
banned = {BANNED!r}
class Ban:
    def find_spec(self, name, path=None, target=None):
        if any(name == entry or name.startswith(entry + ".") for entry in banned):
            raise ImportError(name + " is banned here")
sys.meta_path.insert(0, Ban())
import estimate
status = estimate.main(["direct", {str(tmp_path / "clip")!r}, "--output", {str(tmp_path / "out")!r}])
loaded = [name for name in sys.modules if any(name == entry or name.startswith(entry + ".") for entry in banned)]
assert not loaded, loaded
sys.exit(status)
"""
    run = subprocess.run([sys.executable, "-c", program], cwd=ROOT, capture_output=True, text=True, timeout=120)
    assert run.returncode == 0, run.stderr
    assert rows(tmp_path / "out" / "clip")[0]["status"] == "ok"


@pytest.mark.parametrize("arguments", [["--version"], ["--help"], ["direct", "--help"]])
def test_help_and_version(arguments: list[str], capsys: pytest.CaptureFixture) -> None:
    with pytest.raises(SystemExit) as ended:
        estimate.main(arguments)
    assert ended.value.code == 0
    assert capsys.readouterr().out


@pytest.mark.slow
def test_real_clip(real_data: Path, tmp_path: Path) -> None:
    """Judged: the grasper holds the gallbladder from frame 149 on, and pulls aslant; ten noisy frames tell nothing."""
    assert call(real_data / "cholecseg8k", tmp_path) == 0
    (row,) = rows(tmp_path / "video01_00080")
    assert 149 <= int(row["onset_frame"]) <= 151
    assert row["verdict"] == "undetermined"
    assert "to the line of sight, so its dent may hide its own bottom; intervals are widened" in row["detail"]
    assert "lies at the end of the stiffness's admissible range" in row["detail"]
