"""What a term is worth: the ratio and its interval, the table, what is kept, and one real training."""

import subprocess
from pathlib import Path

import numpy as np
import pytest

from palpate.command import train as training
from palpate.common.doors import INTERRUPTED
from palpate.data.synthetic.clip import write_clip
from palpate.data.synthetic.settings import SceneSettings
from palpate.estimators.network.training import TrainingError
from palpate.evaluation.ablation import __main__ as door
from palpate.evaluation.ablation import terms
from palpate.evaluation.ablation.generated import TrainedGenerator
from palpate.evaluation.ablation.terms import compared, judge, judged_clips, table, train
from palpate.evaluation.harness import Row
from palpate.results.store import OutputError
from tests.evaluation.ablation.trained_generators import write_checkpoint

TRUTH = np.array([[-1.0, -3.0, -2.0], [-0.5, -2.0, -3.0], [-0.1, -4.0, -2.5]])


def judged(error: float, picture: float = 1.0) -> Row:
    """Of a suite: all parameters off by an error of alternating sign, and pictures so much worse than copies."""
    copied, generated = np.array([[2.0, 4.0], [1.0, 0.5], [3.0, 3.0]]), picture * np.array([2.0, 1.0, 3.0])
    estimate = TRUTH + error * np.array([[1], [-1], [1]])
    return {"truth": TRUTH, "estimate": estimate, "copied": copied, "generated": generated}


def of_every_suite(row: str, turn: int, found: Row) -> list[Row]:
    return [{"row": row, "turn": turn, "suite": suite, **found} for suite in terms.SUITES]


def test_a_ratio_of_what_is_always_twice_as_large_is_two_for_sure() -> None:
    full = np.random.default_rng(0).uniform(1, 5, (3, 8))
    np.testing.assert_allclose(compared(2 * full, full), [2, 2, 2])


def test_an_interval_is_of_resampled_seeds_and_clips() -> None:
    """Against plain loops."""
    draw = np.random.default_rng(1)
    row, full = draw.uniform(1, 2, (2, 5)), draw.uniform(1, 2, (2, 5))
    ratios = []
    for _ in range(4000):
        seeds, clips = draw.integers(2, size=2), draw.integers(5, size=5)
        sums = [sum(values[seed, clip] for seed in seeds for clip in clips) for values in (row, full)]
        ratios.append(sums[0] / sums[1])
    ratio, low, high = compared(row, full)
    assert ratio == pytest.approx(row.sum() / full.sum())
    np.testing.assert_allclose([low, high], np.quantile(ratios, [0.025, 0.975]), atol=0.02)


def test_the_table_divides_by_the_whole_system() -> None:
    found = of_every_suite("full", 0, judged(0.1)) + of_every_suite("full", 1, judged(0.1))
    found += of_every_suite("no-gan", 0, judged(0.15, 2.0))
    rows = {(row["suite"], row["row"]): row for row in table(found).to_dict("records")}
    assert list(rows) == [(suite, name) for suite in ("clean", "noisy") for name in ("full", "no-gan")]
    whole, without = rows["clean", "full"], rows["noisy", "no-gan"]
    assert (whole["seeds"], without["seeds"]) == (2, 1)
    assert np.isnan(whole["error"])
    assert [without[name] for name in ("error", "error_low", "error_high")] == pytest.approx([1.5, 1.5, 1.5])
    assert [without[name] for name in ("depth", "depth_low", "depth_high")] == pytest.approx([2, 2, 2])
    assert whole["depth_copy"] == pytest.approx(6 / 6)  # the better copy is the last map
    assert without["depth_copy"] == pytest.approx(12 / 6)
    spread = np.std(TRUTH[:, 0] + [0.1, -0.1, 0.1]) / np.std(TRUTH[:, 0])
    assert whole["spread_stiffness"] == pytest.approx(spread)
    # Without the whole system nothing is relative.
    (row, _) = table(of_every_suite("no-gan", 0, judged(0.1))).to_dict("records")
    assert row["depth_copy"] == pytest.approx(1)
    assert np.isnan(row["error"])


def test_a_training_that_fails_says_its_last_sentence(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def fail(command: list[str], **_: object) -> subprocess.CompletedProcess:
        assert command[-2:] == ["--model.picture", "false"]
        assert "--trainer.limit_train_batches=7" in " ".join(command).replace("batches ", "batches=")
        return subprocess.CompletedProcess(command, 2, "", "noise\ntrain.py: no clips here.\n")

    monkeypatch.setattr(terms.subprocess, "run", fail)
    with pytest.raises(TrainingError, match=r"no-picture, seed 1: .*no clips here"):
        train("no-picture", 1, tmp_path, 7, tmp_path)


def test_a_user_s_folder_of_a_row_s_name_stays(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """So does one that was made meanwhile, and nothing of a training that fails is left."""
    folder = terms.folder_of(tmp_path, "full", 0)
    (folder / "photos").mkdir(parents=True)
    (folder / "photos" / "1.jpg").write_text("precious")
    with pytest.raises(OutputError, match=r"full-0: holds no finished training; move it away or choose another"):
        train("full", 0, tmp_path, 7, tmp_path)
    output = tmp_path / "out"

    def trained(command: list[str], **_: object) -> subprocess.CompletedProcess:
        made = Path(command[command.index("--trainer.default_root_dir") + 1]) / "checkpoints" / "last.ckpt"
        made.parent.mkdir(parents=True)
        made.touch()
        (output / "full-0").mkdir()
        (output / "full-0" / "mine").write_text("precious")
        return subprocess.CompletedProcess(command, 0, "", "")

    monkeypatch.setattr(terms.subprocess, "run", trained)
    with pytest.raises(OutputError, match="Directory not empty"):
        train("full", 0, tmp_path, 7, output)
    assert [path.name for path in output.iterdir()] == ["full-0"]
    assert (output / "full-0" / "mine").read_text() == (folder / "photos" / "1.jpg").read_text() == "precious"


def test_what_is_trained_and_judged_is_kept(tmp_path, monkeypatch, capsys) -> None:
    trained: list[tuple[str, int]] = []

    def once(row: str, seed: int, clips: Path, steps: int, output: Path) -> Path:
        if len(trained) == 3:
            raise KeyboardInterrupt
        trained.append((row, seed))
        folder = terms.folder_of(output, row, seed)
        folder.mkdir(parents=True)
        return write_checkpoint(folder / "last.ckpt")

    monkeypatch.setattr(terms, "train", once)
    monkeypatch.setattr(terms, "judged_clips", lambda *_: {suite: [] for suite in terms.SUITES})
    monkeypatch.setattr(terms, "judge", lambda generator, clips: judged(0.1))
    (tmp_path / "clips" / "video01").mkdir(parents=True)
    command = ["terms", "--output", str(tmp_path / "out"), "--clips", str(tmp_path / "clips"), "--seeds", "2"]
    command += ["--rows", "no-gan", "full"]
    assert door.main(command) == INTERRUPTED
    assert "what is finished is kept" in capsys.readouterr().err
    trained.pop(0)
    assert door.main(command) == 0
    assert trained == [("no-gan", 0), ("full", 1), ("no-gan", 1)]  # one seed of all rows after the other
    lines = (tmp_path / "out" / "table.csv").read_text().splitlines()
    assert lines[0] == ",".join(terms.COLUMNS)
    assert [line.split(",")[:3] for line in lines[1:3]] == [["clean", "full", "2"], ["clean", "no-gan", "2"]]
    assert lines[2].startswith("clean,no-gan,2,1,1,1,")
    assert "no-gan" in capsys.readouterr().out
    assert door.main([*command, "--steps", "9"]) == 2
    assert "holds results of another steps" in " ".join(capsys.readouterr().err.split())


def test_impossible_options_are_told(tmp_path: Path, capsys: pytest.CaptureFixture) -> None:
    output = ["--output", str(tmp_path / "out")]
    for arguments, message in (
        (["terms", *output, "--clips", str(tmp_path), "--rows", "K=2"], "--rows K=2: give some of full, no-gan"),
        (["terms", *output, "--clips", str(tmp_path), "--seeds", "0"], "--seeds: 0 is less than 1"),
        (["terms", *output, "--clips", str(tmp_path / "none")], "none is not a folder"),
    ):
        with pytest.raises(SystemExit, match=r"^2$"):
            door.main(arguments)
        assert message in capsys.readouterr().err
    assert door.main(["weights", *output]) == 2
    assert "Give one of terms, next-depth" in capsys.readouterr().err


@pytest.mark.slow
def test_a_generator_is_judged_by_its_last_word_and_by_the_pictures_between(tmp_path: Path) -> None:
    (clip,) = judged_clips(0, 1)["clean"]
    generator = TrainedGenerator(write_checkpoint(tmp_path / "last.ckpt"))
    found = judge(generator, [clip])
    last = clip.motion.onset_frame + 25
    np.testing.assert_allclose(found["estimate"], [np.log(np.abs(generator.estimate(clip, last)))])
    np.testing.assert_allclose(found["truth"], [np.log(np.abs(clip.motion.theta))])
    assert 0 < found["generated"][0] < 0.5 * min(found["copied"][0])


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore:LightningCLI's args parameter")
def test_a_real_row_at_toy_size(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Trained in this process, which has the libraries."""

    def run(command: list[str], **_: object) -> subprocess.CompletedProcess:
        return subprocess.CompletedProcess(command, training.main(command[2:]), "", "")

    monkeypatch.setattr(terms.subprocess, "run", run)
    monkeypatch.chdir(terms.ROOT)
    scene = SceneSettings(width=214, height=120, frames=20, depth_noise=0.001)
    for number in range(1, 5):
        write_clip(tmp_path / "clips", number, scene, number)
    command = ["terms", "--output", str(tmp_path / "out"), "--clips", str(tmp_path / "clips"), "--rows", "no-gan"]
    assert door.main([*command, "--seeds", "1", "--steps", "5", "--held-out", "1"]) == 0
    lines = (tmp_path / "out" / "table.csv").read_text().splitlines()
    assert [line.split(",")[:2] for line in lines[1:]] == [["clean", "no-gan"], ["noisy", "no-gan"]]
    assert float(lines[1].split(",")[9]) < 0.8  # physics has the picture right before any training
