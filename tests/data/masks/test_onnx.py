"""Segmentation models plug in by settings; what can't be used gets a sentence."""

import json

import numpy as np
import pytest

from palpate.data.masks.onnx import OnnxMasks
from palpate.data.masks.request import MaskClasses
from palpate.data.masks.sources import mask_source_file, open_masks
from palpate.data.source.frames import Frame
from palpate.data.source.layout import ClipLayout, InputError
from tests.networks import write_network

WEIGHTS = np.array([[0, 0, 0], [8, -8, 0], [-8, 8, 0]], np.float32)
"""Class logits from (R, G, B): 0 other, 1 rises with red over green, 2 with green over red."""


def save_model(
    path, settings=None, *, weights=WEIGHTS, size=("h", "w"), nhwc=False, labels=False, values="float", batch=1
):
    """A 1x1 convolution as a segmentation model, of a picture of `values`."""
    height, width = size
    taken = f"1, {height}, {width}, 3" if nhwc else f"1, 3, {height}, {width}"
    taken = f"{batch}{taken[1:]}"
    given = "int64[1, p, q] last" if labels else "float[1, p, q, c] last" if nhwc else "float[1, c, p, q] last"
    end = "ArgMax<axis=1, keepdims=0>(" if labels else "Transpose<perm=[0, 2, 3, 1]>(" if nhwc else "Identity("
    graph = f"""segmentation ({values}[{taken}] picture) => ({given}) {{
        numbers = Cast<to=1>(picture)
        first = {"Transpose<perm=[0, 3, 1, 2]>" if nhwc else "Identity"}(numbers)
        logits = Conv(first, kernel)
        last = {end}logits)
    }}"""
    path.parent.mkdir(parents=True, exist_ok=True)
    if settings is not None:
        path.with_suffix(".yaml").write_text(json.dumps(settings))  # JSON is YAML
    return write_network(path, graph, kernel=weights.reshape(len(weights), 3, 1, 1))


PLAIN = {"mean": [0, 0, 0], "std": [1, 1, 1]}
BOTH = PLAIN | {"tool": [2], "tissue": [1]}


def scene() -> tuple[Frame, np.ndarray]:
    """Red tissue left, green tool right, grey above; and its label map."""
    image = np.full((96, 128, 3), 90, np.uint8)
    labels = np.zeros((96, 128), np.uint8)
    image[32:, :64], labels[32:, :64] = (220, 20, 20), 1
    image[32:, 64:], labels[32:, 64:] = (20, 220, 20), 2
    return Frame(0, 0, 0.0, image), labels


@pytest.mark.parametrize(
    ("model", "settings"),
    [
        ({}, {}),
        ({"size": (96, 128)}, {}),
        ({"nhwc": True}, {"axes": "nhwc"}),
        ({"labels": True}, {"output": "labels"}),
        ({"weights": WEIGHTS[:, ::-1].copy()}, {"channels": "bgr"}),
    ],
)
def test_models_of_every_form_find_tool_and_tissue(tmp_path, model, settings):
    path = save_model(tmp_path / "m.onnx", BOTH | settings, **model)
    frame, expected = scene()
    found = open_masks(str(path), ClipLayout(), MaskClasses(), tmp_path)(frame)
    if settings.get("output") == "labels":
        # A tie of the logits goes to the first class, as in the scene.
        assert np.array_equal(found, expected)
    assert (found == expected)[34:, :].mean() > 0.99
    assert set(np.unique(found)) == {0, 1, 2}


def test_input_of_another_size_is_resized_and_back(tmp_path):
    path = save_model(tmp_path / "m.onnx", BOTH, size=(48, 64))
    frame, expected = scene()
    found = OnnxMasks(path)(frame)
    assert found.shape == expected.shape
    assert (found == expected).mean() > 0.97


def test_settings_beside_the_model_win_and_sigmoid_of_one_channel(tmp_path):
    path = save_model(tmp_path / "m.onnx", {"tool": [5]}, weights=WEIGHTS[2:])
    (tmp_path / "m.yaml").write_text("tool: [0]\noutput: sigmoid_logits\nthreshold: 0.9\nmean: [0,0,0]\nstd: [1,1,1]\n")
    frame, expected = scene()
    found = OnnxMasks(path)(frame)
    assert np.array_equal(found == 2, expected == 2)
    # No tissue channel: the lit rest is tissue.
    assert np.array_equal(found == 1, expected != 2)


def test_identity_follows_the_file_and_the_settings(tmp_path):
    first, second = (OnnxMasks(save_model(tmp_path / f"{tool}.onnx", {"tool": [tool]})) for tool in (2, 1))
    assert first.identity != second.identity
    assert first.identity == OnnxMasks(tmp_path / "2.onnx").identity
    first.reset()


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        (None, r"has no settings; write m\.yaml next to it"),
        ({}, r"lacks 'tool'; give \[a whole number, …\]"),
        ({"tool": [1], "tissu": [2]}, "unknown key 'tissu'; known are tool"),
        ({"tool": []}, "at least one output channel"),
        ({"tool": [1], "tissue": [1]}, "share a channel"),
        ({"tool": [1], "output": "scores"}, "give one of logits"),
        ({"tool": [1], "std": [1, 1, 0]}, "numbers above 0"),
        ({"tool": [1], "threshold": 1.5}, "give 1e-06 to 0.999999"),
        ({"tool": [1], "height": 0}, "height is 0; give 1 to 4096"),
        ({"tool": [1], "axes": "nhwc"}, "takes w channels|not one picture|3 channels|takes"),
    ],
)
def test_wrong_settings_get_a_sentence(tmp_path, settings, message):
    path = save_model(tmp_path / "m.onnx", settings, size=(96, 128))
    with pytest.raises(InputError, match=message) as caught:
        OnnxMasks(path)
    assert str(tmp_path / "m.") in str(caught.value)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("model", "settings", "message"),
    [
        ({}, {"tool": [7]}, "without a channel 7"),
        ({"weights": WEIGHTS[2:]}, {"tool": [0]}, "sigmoid_logits"),
        ({}, {"tool": [1], "output": "labels"}, "not one label a pixel"),
        ({"size": (96, 128)}, {"tool": [1], "height": 50}, "check the size"),
        ({"weights": WEIGHTS * np.float32(np.nan)}, {"tool": [1]}, "not finite"),
    ],
)
def test_wrong_outputs_get_a_sentence(tmp_path, model, settings, message):
    masks = OnnxMasks(save_model(tmp_path / "m.onnx", settings, **model))
    with pytest.raises(InputError, match=message) as caught:
        masks(scene()[0])
    assert "\n" not in str(caught.value)


def test_files_that_are_no_models(tmp_path):
    with pytest.raises(InputError, match=r"absent\.onnx does not exist; check the path"):
        mask_source_file(str(tmp_path / "absent.onnx"))
    path, unread = tmp_path / "x.onnx", "Protobuf parsing failed"
    for content, reason in ((b"hello", unread), (b"\x00" * 100, unread), (b"", "No graph was found in the protobuf")):
        path.write_bytes(content)
        with pytest.raises(InputError) as caught:
            OnnxMasks(path)
        said = f"can't be opened as an ONNX model ({reason}); export or download it again."
        assert str(caught.value) == f"{path} {said}"


def test_a_fixed_batch_is_named_with_its_remedy(tmp_path):
    path = save_model(tmp_path / "four.onnx", {"tool": [1]}, batch=4)
    with pytest.raises(InputError, match=r"takes 4 pictures at once; export it with a batch of 1 or a dynamic batch"):
        OnnxMasks(path)


def test_a_model_of_8_bit_pictures_is_refused_since_its_input_would_be_rounded(tmp_path):
    model = save_model(tmp_path / "raw.onnx", {"tool": [1]}, values="uint8")
    with pytest.raises(InputError, match=r"picture tensor\(uint8\).*not one colour picture"):
        OnnxMasks(model)


def test_labels_may_be_any_numbers(tmp_path):
    """Not a map for every number up to the largest, which would be gigabytes."""
    frame, expected = scene()
    settings = PLAIN | {"tool": [2, 2**40], "tissue": [1, 65535], "output": "labels"}
    large = save_model(tmp_path / "large.onnx", settings, labels=True)
    np.testing.assert_array_equal(OnnxMasks(large)(frame), expected)
