"""Presets: every shipped one loads and says what its network needs; wrong ones get a sentence."""

import pytest

from palpate.data.depth.preset import DepthPreset, load_preset, preset_names, resolve_model
from palpate.data.source.layout import InputError


def test_shipped_presets_are_the_documented_ones():
    presets = {name: load_preset(name) for name in preset_names()}
    networks = "depth-anything-v2 depth-anything-v2-metric depthpro depthpro-canonical metric3d midas-small"
    assert [preset.name for preset in presets.values()] == list(presets) == networks.split()
    assert all(preset.obtain for preset in presets.values())
    depthpro, metric3d = presets["depthpro"], presets["metric3d"]
    assert (depthpro.focal_output, depthpro.focal_grid) == ("focallength_px", 1536)
    assert presets["depth-anything-v2"].kind == "relative_inverse"
    assert (metric3d.value_scale, metric3d.mean, metric3d.canonical_focal_px) == (255, (0.0, 0.0, 0.0), 1000)


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("kind: metric\nsise: [3, 4]\n", "unknown key 'sise'"),
        ("kind: depth\n", "give one of metric"),
        ("size: [3, 4]\n", "lacks 'kind'"),
        ("kind: metric\nresize: shorter\nsize: [3, 4]\n", "needs one number"),
        ("kind: metric\nresize: exact\nsize: 5\n", "[height, width]"),
        ("kind: metric\nstd: [1, 0, 1]\n", "std"),
        ("kind: metric\nmean: [.nan, 0, 0]\n", "[a number, a number, a number]"),
        ("kind: metric\nfactor: 0\n", "factor"),
        ("kind: metric\nmultiple: 0\n", "multiple is 0; give 1 to 4096"),
        ("kind: metric\nresize: none\nletterbox: true\n", "letterbox"),
    ],
)
def test_wrong_preset_file_is_named_with_the_reason(tmp_path, text, expected):
    path = tmp_path / "mine.yaml"
    path.write_text(text)
    with pytest.raises(InputError, match=r"mine\.yaml") as caught:
        load_preset(path)
    assert expected in str(caught.value)
    assert "\n" not in str(caught.value)


def test_preset_file_takes_its_name_from_the_file(tmp_path):
    path = tmp_path / "mine.yaml"
    path.write_text("kind: inverse\noutput: disparity\n")
    assert load_preset(path) == DepthPreset(name="mine", kind="inverse", output="disparity")


def test_unknown_preset_lists_the_known_ones():
    with pytest.raises(InputError, match=r"'depthpr' is no depth preset.*depthpro, depthpro-canonical"):
        load_preset("depthpr")


def test_identity_changes_with_every_fact():
    first = DepthPreset(name="a", kind="metric")
    assert first.identity == DepthPreset(name="a", kind="metric", obtain="elsewhere").identity
    assert first.identity != DepthPreset(name="a", kind="metric", factor=2).identity


def test_missing_model_says_where_to_get_it():
    for asked, said in {
        ("depthpro", None, None): r"depthpro needs a model file; download onnx/model.onnx .* depth\.model\.",
        (
            "depthpro",
            "nowhere.onnx",
            None,
        ): r"nowhere.onnx \(for depth preset depthpro\) does not exist; .*, or download",
        ("nowhere.onnx", None, "depthpro"): r"nowhere\.onnx does not exist",
    }.items():
        with pytest.raises(InputError, match=said):
            resolve_model(*asked)


def test_onnx_path_needs_a_preset_or_a_file_beside_it(tmp_path):
    model = tmp_path / "network.onnx"
    model.touch()
    with pytest.raises(InputError, match=r"Nothing says how to read .*network.onnx.*network.yaml"):
        resolve_model(str(model), None, None)
    assert resolve_model(str(model), None, "midas-small") == (model, load_preset("midas-small"))
    (tmp_path / "network.yaml").write_text("kind: inverse\n")
    assert resolve_model(str(model), None, None)[1].kind == "inverse"
