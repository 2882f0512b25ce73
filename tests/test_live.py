"""The door that estimates while pictures come."""

import io
import json
import signal
import socket
import subprocess
import sys
import time
from subprocess import PIPE
from types import SimpleNamespace

import numpy as np
import pytest
from pyigtl import OpenIGTLinkClient

from palpate.command.live import JsonLines, igtl_server, main
from palpate.common.doors import INTERRUPTED
from palpate.data.source.frames import open_source
from palpate.data.source.layout import ClipLayout
from palpate.data.source.live import LiveSource
from palpate.data.synthetic.clip import write_clip
from palpate.data.synthetic.settings import SceneSettings
from palpate.estimators.records import FrameEstimate


@pytest.fixture(scope="module")
def pictures(tmp_path_factory) -> np.ndarray:
    """A drawn press, RGB [N, H, W, 3]."""
    settings = SceneSettings(width=214, height=120, frames=16)
    clip = write_clip(tmp_path_factory.mktemp("live"), 1, settings, 3)
    return np.stack([frame.picture for frame in open_source(clip, ClipLayout())])


def test_every_frame_of_a_pipe_is_printed_once_with_how_late_it_is(pictures, monkeypatch, capsys) -> None:
    twice = np.concatenate([pictures, pictures])
    monkeypatch.setattr("sys.stdin", SimpleNamespace(buffer=io.BytesIO(twice.tobytes())))
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as listening:
        listening.bind(("127.0.0.1", 0))
        listening.settimeout(10)
        port = str(listening.getsockname()[1])
        assert main(["-", "--size", "214x120", "--max-latency", "600", "--port", port, "--force-limit", "0.1"]) == 0
        said = capsys.readouterr()
        lines = [json.loads(line) for line in said.out.splitlines()]
        assert [json.loads(listening.recv(1 << 16)) for _ in lines] == lines
    frames, first = ([line for line in lines if line.get("decided") is decided] for decided in (True, False))
    assert [line["frame"] for line in first] == [line["frame"] for line in frames]
    assert all(lines.index(one) < lines.index(last) for one, last in zip(first, frames, strict=True))
    assert all(0 < one["latency_s"] < last["latency_s"] for one, last in zip(first, frames, strict=True))
    assert {one.get("status", last["status"]) for one, last in zip(first, frames, strict=True)} >= {"no_tool"}
    # The first half second went into the depth's scale.
    assert [line["frame"] for line in frames] == list(range(len(frames)))
    assert 0 < len(frames) < len(twice)
    assert all(0 < line["latency_s"] < 600 and line["dropped"] == 0 and line["status"] for line in frames)
    assert {line["alarm"] for line in frames} <= {"", "below", "above", "unknown"}
    assert f"of {len(frames)} frames" in said.err
    assert f"{len(frames)} frames, " in said.err
    assert "0 were dropped" in said.err


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


def test_an_openigtlink_client_gets_the_same_lines(pictures) -> None:
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    source = LiveSource("somewhere", pictures[:3], 25.0, 600.0)
    server, client = igtl_server(port), OpenIGTLinkClient("127.0.0.1", port)
    try:
        lines = JsonLines(source, None, server, None)
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
