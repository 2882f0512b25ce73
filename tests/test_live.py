"""The door that estimates while pictures come."""

import io
import json
import re
import signal
import socket
import subprocess
import sys
import time
from subprocess import PIPE
from types import SimpleNamespace
from typing import get_type_hints

import cv2
import numpy as np
import pytest
import yaml
from pyigtl import OpenIGTLinkClient

from palpate.cli.live import LIVE, JsonLines, igtl_server, main
from palpate.common.doors import INTERRUPTED
from palpate.data.depth.model import RawDepth
from palpate.data.depth.stereo import StereoDepth
from palpate.data.source.frames import Frame, open_source
from palpate.data.source.layout import ClipLayout
from palpate.data.source.live import LiveSource
from palpate.data.synthetic.clip import write_clip
from palpate.data.synthetic.settings import SceneSettings
from palpate.estimators.open import ESTIMATORS
from palpate.estimators.records import FrameEstimate


@pytest.fixture(scope="module")
def pictures(tmp_path_factory) -> np.ndarray:
    """A drawn press, RGB [N, H, W, 3]."""
    settings = SceneSettings(width=214, height=120, frames=16)
    clip = write_clip(tmp_path_factory.mktemp("live"), 1, settings, 3)
    return np.stack([frame.picture for frame in open_source(clip, ClipLayout())])


def test_every_frame_of_a_pipe_is_printed_once_with_how_late_it_is(pictures, monkeypatch, capsys) -> None:
    monkeypatch.setattr("sys.stdin", SimpleNamespace(buffer=io.BytesIO(pictures.tobytes())))
    assert main(["-", "--size", "214x120", "--max-latency", "600", "--force-limit", "0.1"]) == 0
    said = capsys.readouterr()
    lines = [json.loads(line) for line in said.out.splitlines()]
    frames, first = ([line for line in lines if line.get("decided") is decided] for decided in (True, False))
    assert [line["frame"] for line in first] == [line["frame"] for line in frames]
    assert all(lines.index(one) < lines.index(last) for one, last in zip(first, frames, strict=True))
    assert all(0 < one["latency_s"] < last["latency_s"] for one, last in zip(first, frames, strict=True))
    assert any(0 < one.get("contact_probability", 0) < 1 for one in first)
    assert {one.get("status", last["status"]) for one, last in zip(first, frames, strict=True)} >= {"no_contact"}
    # The first half second went into the depth's scale.
    assert [line["frame"] for line in frames] == list(range(len(frames)))
    assert 0 < len(frames) < len(pictures)
    assert all(0 < line["latency_s"] < 600 and line["dropped"] == 0 and line["status"] for line in frames)
    assert {line["alarm"] for line in frames} <= {"", "below", "above", "unknown"}
    assert f"of {len(frames)} frames" in said.err
    assert f"{len(frames)} frames, " in said.err
    assert "0 were dropped" in said.err


@pytest.mark.parametrize("how", ["side-by-side", "top-bottom"])
def test_pictures_of_a_pipe_may_hold_both_of_a_stereo_pair(how, tmp_path, monkeypatch, capsys) -> None:
    grain = np.random.default_rng(0).uniform(40, 200, (120, 248, 1)).repeat(3, 2)
    grain = cv2.GaussianBlur(grain, None, 1.5).astype(np.uint8)
    left, right = grain[:, :214], grain[:, 20:234]  # 20 px of disparity
    both = np.concatenate([left, right], axis=1 if how == "side-by-side" else 0)
    camera = {"fx": 200.0, "fy": 200.0, "cx": 106.5, "cy": 59.5, "width": 214, "height": 120, "baseline": 0.005}
    (tmp_path / "camera.yaml").write_text(yaml.safe_dump(camera))
    depths, found = [], StereoDepth.observe

    def observe(self: StereoDepth, frame: Frame) -> RawDepth:
        depths.append(found(self, frame))
        return depths[-1]

    monkeypatch.setattr(StereoDepth, "observe", observe)
    monkeypatch.setattr("sys.stdin", SimpleNamespace(buffer=io.BytesIO(24 * both.tobytes())))
    size = f"{both.shape[1]}x{both.shape[0]}"
    told = ["-", "--size", size, "--max-latency", "600", "--depth", "stereo", "--camera", str(tmp_path / "camera.yaml")]
    assert main([*told, "--right", how]) == 0
    lines = [json.loads(line) for line in capsys.readouterr().out.splitlines()]
    assert {line["status"] for line in lines} == {"no_tool"}
    assert len(depths) > 10
    known = depths[-1].values[depths[-1].values > 0]
    assert len(known) > 0.7 * 214 * 120
    assert np.median(known) == pytest.approx(0.005 * 200 / 20, rel=0.01)
    monkeypatch.setattr("sys.stdin", SimpleNamespace(buffer=io.BytesIO(24 * both.tobytes())))
    assert main(told) == 2
    assert "has no right pictures; say in a layout file where they are, live by --right" in capsys.readouterr().err


def test_ctrl_c_ends_a_source_that_stalls(pictures) -> None:
    command = [sys.executable, "-m", "palpate", "live", "-", "--size", "214x120", "--max-latency", "600"]
    with subprocess.Popen(command, stdin=PIPE, stdout=PIPE, stderr=PIPE, text=False) as program:
        program.stdin.write(np.concatenate([pictures] * 3).tobytes())
        program.stdin.flush()  # and left open
        assert json.loads(program.stdout.readline())["frame"] == 0
        program.send_signal(signal.SIGINT)
        _, said = program.communicate(timeout=60)
    assert program.returncode == INTERRUPTED
    assert b"frames, " in said


@pytest.mark.parametrize(
    ("arguments", "reason"),
    [
        (["-"], "give --size"),
        (["nowhere.mp4"], "is no file, stream or camera"),
        (["97", "--size", "64x48"], "leave --size out"),
        (["-", "--size", "8x8"], "pictures of 8x8"),
        (["-", "--size", "214x120", "--model", "nowhere.onnx"], "nowhere.onnx"),
    ],
)
def test_what_cannot_be_used_is_said(arguments, reason, monkeypatch, capsys) -> None:
    monkeypatch.setattr("sys.stdin", SimpleNamespace(buffer=io.BytesIO(bytes(8 * 8 * 3))))
    assert main(arguments) == 2
    assert reason in capsys.readouterr().err


def test_a_busy_port_and_a_number_of_no_camera_are_named(capsys) -> None:
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
        with pytest.raises(
            ValueError, match=rf"--igtl {port} can't be opened \(Address already in use\); give another"
        ):
            igtl_server(port)
    assert main(["9" * 20]) == 2
    assert "is no camera's number" in capsys.readouterr().err


def test_an_openigtlink_client_gets_the_same_lines(pictures) -> None:
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    source = LiveSource("somewhere", pictures[:3], 25.0, 600.0)
    server, client = igtl_server(port), OpenIGTLinkClient("127.0.0.1", port)
    try:
        lines = JsonLines(source, server, None)
        for _ in range(100):
            if server.is_connected() and client.is_connected():
                break
            time.sleep(0.05)
        lines.add(FrameEstimate(3, 0.12, "no_tool"))
        message = client.wait_for_message("palpate", timeout=10)
        assert json.loads(message.string)["status"] == "no_tool"
    finally:
        client.stop()
        server.stop()


def test_stiffness_place_by_place_is_estimated_live(tmp_path, monkeypatch, capsys) -> None:
    clip = write_clip(tmp_path, 1, SceneSettings(width=214, height=120, frames=20, action="grip"), 3)
    pictures = np.stack([frame.picture for frame in open_source(clip, ClipLayout())])
    (tmp_path / "online.yaml").write_text("particles: 60\n")
    monkeypatch.setattr("sys.stdin", SimpleNamespace(buffer=io.BytesIO(pictures.tobytes())))
    told = ["-", "--size", "214x120", "--max-latency", "600", "--estimator", "online"]
    assert main([*told, "--settings", str(tmp_path / "online.yaml")]) == 0
    lines = [json.loads(line) for line in capsys.readouterr().out.splitlines()]
    assert any("gap" in line for line in lines if line.get("decided"))
    assert "Relative stiffness place by place" in lines[-1]["interaction"]["detail"]
    assert main(["-", "--size", "214x120", "--estimator", "online", "--force-limit", "1"]) == 2
    assert "needs the force of every frame, which --estimator online does not give" in capsys.readouterr().err


def test_only_live_estimators_are_offered(capsys) -> None:
    kinds = {name: get_type_hints(ESTIMATORS[name].build)["return"].live for name in ESTIMATORS.entries}
    assert [*LIVE.entries] == [name for name, live in kinds.items() if live]
    with pytest.raises(SystemExit, match=r"^2$"):
        main(["-", "--estimator", "direct"])
    assert "there is no live estimator direct; choose network, online." in capsys.readouterr().err
    with pytest.raises(SystemExit, match=r"^0$"):
        main(["--help"])
    assert not re.search(r"\bdirect\b|\bgan\b", capsys.readouterr().out)
