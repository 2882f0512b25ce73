"""Commands of README and guide run as they stand there, on small inputs of these names."""

import re
import shlex
import shutil
from pathlib import Path

import numpy as np
import pytest
import yaml

from palpate.__main__ import main
from palpate.data.source.images import read_image
from tests.conftest import CHECKOUT
from tests.data.bags import write_bag
from tests.data.depth.test_model import build
from tests.data.masks.test_onnx import BOTH, save_model
from tests.inference_inputs import SIZE, encode, write_clip, write_model, write_video
from tests.sequences import write_sequence
from tests.test_docs import GUIDE

pytestmark = [pytest.mark.slow, pytest.mark.usefixtures("blank_pictures")]
ELSEWHERE = {
    "make ": ".ci/run",
    "pip install": "tests/palpate/test_wheel.py",
    "python train.py": "tests/test_train.py",
    "DATA=": "tests/test_train.py",
    "python -m benchmarks.recovery": "tests/benchmarks/test_benchmark.py",
    "python -m benchmarks.instruments": "tests/data/masks/test_cut.py",
    "palpate calibrate palpation": "tests/test_calibrate.py",
    "palpate outline": "tests/test_outline_page.py",
    "palpate plan configs/": "tests/planning/test_scene.py",
    "palpate live -": "tests/test_live.py",
    "ffmpeg": "tests/test_live.py",
    "depthpro.onnx": "tests/data/depth/test_model.py",
}
"""Commands that train, install, wait for somebody or take long, and what runs them."""
SMALLER = {
    "--clips 30": "--clips 1 --size small --frames 16",
    "--clips 12": "--clips 1 --size small --frames 16",
    "rtsp://127.0.0.1/endoscope": "clip.mp4",
    "live 0": "live clip.mp4",
}


def commands() -> list[str]:
    """Commands of the guide, one a line, each once."""
    code = "\n".join(text for page in GUIDE for text in re.findall(r"```bash\n(.*?)```", page.read_text(), re.DOTALL))
    lines = (" ".join(shlex.split(line, comments=True)) for line in code.replace("\\\n", " ").splitlines())
    parts = (part for line in lines for part in re.split(" && ", line) if part)
    return [*dict.fromkeys(part for part in parts if not any(words in part for words in ELSEWHERE))]


@pytest.fixture(scope="module")
def inputs(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Files of all names that the guide uses."""
    folder = tmp_path_factory.mktemp("guide")
    for name in ("clip", "clips/one", "datasets/cholecseg8k/video01/video01_00080"):
        write_clip(folder / name)
    shutil.copytree(folder / "datasets" / "cholecseg8k", folder, dirs_exist_ok=True)
    lens = {"fx": 140.0, "fy": 140.0, "cx": 79.5, "cy": 47.5, "width": SIZE[0], "height": SIZE[1], "baseline": 0.005}
    for place in (folder, folder / "clip"):
        (place / "camera.yaml").write_text(yaml.safe_dump(lens))
    for left in (folder / "clip").glob("*_endo.png"):
        shutil.copy(left, left.with_name(left.name.replace("endo", "right")))
    (folder / "layout.yaml").write_text("right: frame_{number}_right.png\ncamera: camera.yaml\n")
    for name in ("clip", "my_video", "pull", "video"):
        write_video(folder / f"{name}.mp4")
        (folder / f"{name}.outlines.yaml").write_text("0:\n  - [[60, 0], [60, 30], [95, 30], [95, 0]]\n")
    pictures = [read_image(path) for path in sorted((folder / "clip").glob("*_endo.png"))]
    (folder / "masks").mkdir()
    for index in range(len(pictures)):
        mask = np.zeros(SIZE[::-1], np.uint8)
        mask[:30, 60:95] = 255
        (folder / "masks" / f"{index:06d}.png").write_bytes(encode(mask))

    def recorded(make):
        yield from (("/image", make.image(index, picture)) for index, picture in enumerate(pictures))
        yield from (("/tool/wrench", make.wrench(index, 0.0, 0.0, float(index))) for index in range(len(pictures)))

    write_bag(folder / "recorded.bag", recorded)
    shutil.copy(folder / "recorded.bag", folder / "pull.bag")
    (folder / "forces.csv").write_text("time_s,force_N\n0.0,0.0\n0.15,0.5\n0.3,1.5\n")
    (folder / "known.yaml").write_text("stiffness: 50\n")
    write_model(folder / "parameters.onnx")
    build(folder / "mine.onnx")
    (folder / "mine.yaml").write_text("kind: metric\nresize: none\n")
    save_model(folder / "runs" / "masks" / "instruments.onnx", BOTH)
    write_sequence(folder / "pull", 6)
    (folder / "online.yaml").write_text("particles: 150\n")
    return folder


def test_what_is_run_elsewhere_is_there() -> None:
    assert all((CHECKOUT / path).is_file() for path in ELSEWHERE.values())
    assert len(commands()) > 20


@pytest.mark.parametrize("command", commands())
def test_a_command_of_the_guide_runs(command: str, inputs: Path, tmp_path: Path, monkeypatch, capsys) -> None:
    monkeypatch.chdir(inputs)
    for given, small in SMALLER.items():
        command = command.replace(given, small)
    program, *words = command.partition(" >")[0].split()
    assert program == "palpate"
    if "--output" in words:
        words[words.index("--output") + 1] = str(tmp_path / "out")
    if words[-1] == "--help":
        with pytest.raises(SystemExit, match="0"):
            main(words)
    else:
        assert main(words) == 0, capsys.readouterr().err
