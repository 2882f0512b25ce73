"""Model files that can't be used get a sentence with the remedy."""

import json
from pathlib import Path

import numpy as np
import onnxruntime
import pytest

from palpate.data.picture_network import PictureNetwork
from palpate.models import onnx_session
from tests.data.masks.test_onnx import save_model
from tests.networks import write_network

METADATA = {"format_version": onnx_session.FORMAT_VERSION, "input": {"window": 2, "height": 4, "width": 6}}


def write_model(
    path: Path, metadata: object = METADATA, name: str = "depth", shape: tuple = ("batch", 2, 4, 6)
) -> Path:
    """θ = first three pixels of the input: a graph with the exported signature."""
    if not isinstance(metadata, str | None):
        metadata = json.dumps(metadata)
    graph = f"""parameters (float[{", ".join(map(str, shape))}] {name}) => (float[batch, 3] theta)
        <int64[1] start = {{0}}, int64[1] end = {{3}}, int64[1] axis = {{1}}> {{
            flat = Flatten({name})
            theta = Slice(flat, start, end, axis)
        }}"""
    return write_network(path, graph, None if metadata is None else {onnx_session.METADATA_KEY: metadata})


def test_a_good_file(tmp_path):
    model = onnx_session.ParameterModel(write_model(tmp_path / "m.onnx"), threads=1)
    assert model.window == 2
    assert model.input_size == (4, 6)
    windows = np.arange(96, dtype=np.float64).reshape(2, 2, 4, 6)
    assert model(windows).tolist() == [[0, 1, 2], [48, 49, 50]]
    with pytest.raises(ValueError, match=r"\[1, 1, 4, 6\]; expected \[B, 2, 4, 6\]"):
        model(np.zeros((1, 1, 4, 6)))


def test_not_an_onnx_file(tmp_path):
    with pytest.raises(onnx_session.ModelFileError, match=r"nothing\.onnx is not a file; give"):
        onnx_session.ParameterModel(tmp_path / "nothing.onnx")
    path = write_model(tmp_path / "m.onnx")
    cut = path.read_bytes()[:-40]
    for content in (b"", b"this is text", bytes(range(256)) * 8, cut):
        path.write_bytes(content)
        with pytest.raises(onnx_session.ModelFileError, match=r"m\.onnx (is not a|can't be opened as an ONNX model)"):
            onnx_session.ParameterModel(path)


@pytest.mark.parametrize(
    "metadata",
    [
        *(None, "not json", "[1]", {"format_version": 1}, {"format_version": 1, "input": {}}),
        *(METADATA | {"format_version": version} for version in ("1", None, [1], True, float("nan"))),
        *(METADATA | {"input": size} for size in (3, "window", [[1]])),
        "[" * 100_000,
        '{"format_version": ' + "1" * 5000 + "}",
    ],
)
def test_not_ours(tmp_path, metadata: object):
    with pytest.raises(onnx_session.ModelFileError, match="without palpate's metadata; give"):
        onnx_session.ParameterModel(write_model(tmp_path / "m.onnx", metadata))
    with pytest.raises(onnx_session.ModelFileError, match="update the program"):
        onnx_session.ParameterModel(
            write_model(tmp_path / "m.onnx", METADATA | {"format_version": onnx_session.FORMAT_VERSION + 1})
        )


@pytest.mark.parametrize(("name", "shape"), [("image", ("batch", 2, 4, 6)), ("depth", ("batch", 3, 4, 6))])
def test_other_inputs(tmp_path, name: str, shape: tuple):
    with pytest.raises(onnx_session.ModelFileError, match=r"m\.onnx takes .* not depth \[batch, 2, 4, 6\]"):
        onnx_session.ParameterModel(write_model(tmp_path / "m.onnx", name=name, shape=shape))


def nested(levels: int) -> object:
    """Lists in lists."""
    return [nested(levels - 1)] if levels else 1


@pytest.mark.parametrize(
    ("name", "value"),
    [
        *(("input", METADATA["input"] | {"width": width}) for width in (0, -6, 6.0, True, "6", None, 10**400, 5000)),
        *((name, value) for name in ("bounds", "mechanics", "geometry", "depth", "classes") for value in (None, [], 1)),
        *(("depth", {"source": source}) for source in (None, 3, ["net.onnx"])),
        *((name, value) for name in ("head", "observation", "masks") for value in (None, 7, ["auto"], {})),
        *(("preprocessing_version", value) for value in ("2", 1.5, None, 10**30)),
        *(("bridge_frames", value) for value in ("2", 2.5, True)),
        *(("track_seconds", value) for value in ("1", None, float("nan"), float("inf"), 1e300)),
        *(("units", value) for value in (["s"], {"time": 1}, {"time": "\x1b[2J"}, {"\n": "s"}, {"time": "\ud800"})),
        *(("trained_on", value) for value in ({"noise": ["a"]}, {"depth": "stored"}, {"masks": [1]}, ["depth"])),
        *(("training", value) for value in (["x"], {"weights_sha256": 1})),
        *(("contact", {"press_seconds": value}) for value in (1.0, [1.0], [0.1, "0.2"], [0.1, float("nan")])),
        *(("calibration", value) for value in (None, [1], {"whole": None}, {"whole": [1.0]})),
        ("anything", nested(9)),
        ("anything", nested(900)),
        ("anything", float("-inf")),
        ("a" * 1000, 10**10),
    ],
)
def test_metadata_of_odd_types_is_named_in_one_sentence(tmp_path, name: str, value: object):
    path = write_model(tmp_path / "m.onnx", METADATA | {name: value})
    with pytest.raises(
        onnx_session.ModelFileError, match=r"m\.onnx has unusable metadata, .*; export it again"
    ) as caught:
        onnx_session.open_model(path)
    said = str(caught.value)
    assert said.isprintable()
    assert name[:10] in said or name == "anything"
    assert len(said) < len(str(path)) + 300


def test_infinite_by_its_exponent(tmp_path):
    document = json.dumps(METADATA)[:-1] + ', "track_seconds": 1e999}'
    with pytest.raises(onnx_session.ModelFileError, match="unusable metadata, 'track_seconds': inf"):
        onnx_session.ParameterModel(write_model(tmp_path / "m.onnx", document))


def test_a_file_is_opened_as_the_kind_it_is(tmp_path):
    assert isinstance(onnx_session.open_model(write_model(tmp_path / "m.onnx"), threads=1), onnx_session.ParameterModel)
    path = write_model(tmp_path / "m.onnx", METADATA | {"head": "posterior"})
    expected = r"takes depth \[batch, 2, 4, 6\] and gives theta, not contact .* and log_mean, log_covariance, decisive_"
    with pytest.raises(onnx_session.ModelFileError, match=expected):
        onnx_session.open_model(path)
    with pytest.raises(onnx_session.ModelFileError, match=expected):
        onnx_session.PosteriorModel(path)


def test_metadata_that_is_not_text(tmp_path):
    path = write_model(tmp_path / "m.onnx", METADATA | {"masks": "auto"})
    path.write_bytes(path.read_bytes().replace(b'"auto"', b'"\xff\xfe\xff\xfe"'))
    with pytest.raises(onnx_session.ModelFileError, match="without palpate's metadata"):
        onnx_session.ParameterModel(path)


def test_no_more_threads_are_started_than_there_are_cores(tmp_path, monkeypatch):
    asked, opened = [], onnxruntime.InferenceSession

    def noted(content, options, **others):
        asked.append(options.intra_op_num_threads)
        return opened(content, options, **others)

    monkeypatch.setattr(onnxruntime, "InferenceSession", noted)
    monkeypatch.setattr("os.cpu_count", lambda: 2)
    for threads in (None, 1, 2, 1024):
        onnx_session.ParameterModel(write_model(tmp_path / "m.onnx"), threads)
    PictureNetwork(save_model(tmp_path / "picture.onnx"), threads=1024)
    assert asked == [0, 1, 2, 2, 2]


def test_a_network_that_fails_is_named(tmp_path):
    """Here for want of 4 TB."""
    graph = """parameters (float[batch, 2, 4, 6] depth) => (float[batch, 3] theta)
        <int64[1] many = {1000000000000}, int64[2] two = {-1, 3}> {
            huge = ConstantOfShape(many)
            mean = ReduceMean<keepdims=0>(huge)
            few = Reshape(depth, two)
            theta = Add(few, mean)
        }"""
    path = write_network(tmp_path / "a.onnx", graph, {onnx_session.METADATA_KEY: json.dumps(METADATA)})
    with pytest.raises(
        onnx_session.ModelFileError, match=r"a\.onnx can't be run; export it again with train.py export\."
    ):
        onnx_session.ParameterModel(path).run({"depth": np.zeros((1, 2, 4, 6), np.float32)})
