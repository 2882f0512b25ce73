"""`palpate view`: what its page holds is the simulated motion, the estimate's force and the verdict, and no more."""

import base64
import dataclasses
import json
import re
import shutil
import signal
import subprocess
import sys
import urllib.request
from pathlib import Path

import msgspec
import numpy as np
import pytest
import zstandard

from palpate.__main__ import main
from palpate.command.view import NOTHING
from palpate.data.synthetic.clip import write_clip
from palpate.results.field_file import FieldFile
from palpate.results.field_overlay import MIDDLE, STIFF
from palpate.results.scene.files import read_scene
from palpate.results.scene.kinds import simulated
from tests.results.fields import FIELD_SEEN, REST
from tests.test_architecture import ROOT
from tests.test_infer import SCENE


@pytest.fixture(scope="module")
def results(tmp_path_factory: pytest.TempPathFactory, blank_module: None) -> Path:
    """Of a press whose scene was kept."""
    folder = tmp_path_factory.mktemp("view")
    clip = write_clip(folder / "clips", 1, SCENE, 3)
    clip.with_suffix(".mp4").unlink()
    options = ["--estimator", "direct", "--onset", "stamp", "--export", "vtk", "--no-overlay"]
    assert main(["infer", str(clip), "--output", str(folder / "out"), *options]) == 0
    return folder / "out" / clip.name


def recorded(page: Path) -> tuple[float, list[tuple[float, str, dict]]]:
    """How long a page plays, and when which node gets which properties, arrays among them."""
    packed = base64.b64decode(re.search('__VISER_EMBED_DATA__="([^"]*)"', page.read_text())[1])
    data = zstandard.ZstdDecompressor().decompress(packed[8:])
    at = 8 + int.from_bytes(data[:8], "little")
    told, buffers = msgspec.msgpack.decode(data[8:at]), []
    for length in told["binaryBufferLengths"]:
        at += -at % 8
        buffers.append(data[at : at + length])
        at += length

    def array(value: object) -> object:
        given = isinstance(value, dict) and "__binary_index" in value
        return np.frombuffer(buffers[value["__binary_index"]], value["dtype"]).reshape(-1, 3) if given else value

    named = [(time, each) for time, each in told["messages"] if "name" in each]
    shown = [(t, each["name"], {k: array(v) for k, v in each.get("props", each).items()}) for t, each in named]
    return told["durationSeconds"], shown


def of(nodes: list, time: float, name: str, what: str) -> list:
    """Values of a property of nodes with such a name that are set at a time."""
    return [each[what] for at, n, each in nodes if abs(at - time) < 1e-6 and re.fullmatch(name, n) and what in each]


def test_a_page_holds_the_simulated_motion_force_and_verdict(results: Path, tmp_path: Path) -> None:
    assert main(["view", str(results.parent), "--output", str(tmp_path / "view.html")]) == 0
    (path,) = results.glob("scene_*.vtu")
    scene, (seconds, nodes) = read_scene(path), recorded(tmp_path / "view.html")
    moved, rest = simulated(scene), scene.parts["points"]
    stride = round(0.04 / scene.number("time_step"))
    assert seconds == pytest.approx(0.04 * (len(moved) // stride) + 2)
    captions = [each["text"] for _, name, each in nodes if name == "/0/now" and "text" in each]
    assert len(captions) == 1 + len(moved) // stride
    assert "not metric" in captions[0]
    for frame in (0, 3, 20):
        placed = rest + (moved[stride * frame - 1] if frame else 0)
        tones = [of(nodes, 0.04 * frame, r"/0/\d+", what) for what in ("vertices", "faces", "color")]
        corners = np.concatenate([points[faces] for points, faces in zip(*tones[:2], strict=True)])
        expected = placed[scene.parts["triangles"]]
        assert {each.tobytes() for each in corners} == {each.tobytes() for each in expected.astype(np.float32)}
    # At rest all is in the lightest tone.
    assert [len(points) > 0 for points in of(nodes, 0.0, r"/0/\d+", "vertices")] == [True, *12 * [False]]
    size, low, high = np.ptp(rest, axis=0).max(), *sorted(np.abs(scene.parts["force"].ravel()[1:]))
    ((tail, tip),) = (each.reshape(2, 3) for each in of(nodes, 0.12, "/0/force", "points"))
    np.testing.assert_allclose(size * tip, (rest + moved[3 * stride - 1])[scene.press.vertex], atol=1e-6)
    np.testing.assert_allclose(tip - tail, -0.3 * low / high * scene.press.direction, atol=1e-6)
    ((tail, _),) = (each.reshape(2, 3) for each in of(nodes, 0.12, "/0/upper", "points"))
    np.testing.assert_allclose(np.linalg.norm(tip - tail), 0.3, rtol=1e-5)
    assert [of(nodes, time, "/0/force", "visible")[-1] for time in (0.12, 0.6)] == [True, False]
    assert "released" in captions[15]
    assert "Verdict: determined." in of(nodes, 0, "/0/said", "text")[0]


def test_a_field_is_coloured_where_it_is_determined_and_a_contact_without_is_said_so(results: Path, tmp_path) -> None:
    folder = shutil.copytree(results, tmp_path / "clip")
    record = json.loads((folder / "run.json").read_text())
    record["files"] = {name: digest for name, digest in record["files"].items() if not name.startswith("scene_")}
    (folder / "run.json").write_text(json.dumps(record))
    with pytest.raises(SystemExit, match="1"):
        main(["view", str(folder), "--output", str(tmp_path / "none.html")])
    record["estimator"]["name"] = "online"
    (folder / "run.json").write_text(json.dumps(record))
    onset = int((folder / "interactions.csv").read_text().splitlines()[1].split(",")[0])
    file = FieldFile(folder / "fields.npz")
    seen = dataclasses.replace(FIELD_SEEN, onset_frame=onset, distance=np.array([4.0, 4.0, 4.0, 64.0]))
    file.write(onset, dataclasses.replace(seen, known=np.zeros(4, bool)))
    file.write(onset + 1, dataclasses.replace(seen, known=np.ones(4, bool)))
    file.close()
    assert main(["view", str(folder), "--output", str(tmp_path / "field.html")]) == 0
    _, nodes = recorded(tmp_path / "field.html")
    stiff = MIDDLE + 2 / 3 * (STIFF - MIDDLE)  # one corner of three is 16 = 4² times as stiff as the median
    for time, colors in ((0.0, [(150, 150, 150)]), (0.04, [MIDDLE, stiff])):
        shown = zip(*(of(nodes, time, r"/0/\d+", what) for what in ("vertices", "color")), strict=True)
        np.testing.assert_allclose([color for points, color in shown if len(points)], colors, atol=1)
        assert not any(of(nodes, time, "/0/force", "visible"))
    assert of(nodes, 0.04, "/0/13", "vertices")[0].size == 0
    np.testing.assert_array_equal(of(nodes, 0.0, "/0/13", "vertices")[0], REST + 0.5)
    assert "0% of the points" in of(nodes, 0.0, "/0/now", "text")[0]


def test_a_server_answers_on_this_machine_until_ctrl_c(results: Path) -> None:
    command = [sys.executable, "-m", "palpate", "view", str(*results.glob("scene_*.vtu")), "--port", "18947"]
    with subprocess.Popen(command, cwd=ROOT, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as server:
        address = re.search(r"http://127\.0\.0\.1:18947", server.stdout.readline())[0]
        with urllib.request.urlopen(address, timeout=20) as answer:
            assert b"__VISER_EMBED_DATA__" in answer.read()
        server.send_signal(signal.SIGINT)
        assert server.wait(timeout=20) == 130


def test_what_cannot_be_shown_is_a_sentence(tmp_path: Path, capsys, monkeypatch) -> None:
    (tmp_path / "other.vtu").write_text("<a/>")
    for path, sentence in (
        (tmp_path, NOTHING),
        (tmp_path / "absent", "absent: There is no such file or folder; check it."),
        (tmp_path / "other.vtu", "is no scene to simulate on that palpate wrote"),
    ):
        with pytest.raises(SystemExit, match="1"):
            main(["view", str(path), "--output", str(tmp_path / "view.html")])
        assert sentence in capsys.readouterr().err
    monkeypatch.delitem(sys.modules, "palpate.command.view")
    monkeypatch.setitem(sys.modules, "viser", None)
    assert main(["view", str(tmp_path)]) == 2
    assert capsys.readouterr().err == "palpate: view needs viser; install 'palpate[view]'.\n"
