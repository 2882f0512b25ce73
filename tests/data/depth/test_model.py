"""ONNX depth networks through the preset path: sizes, preprocessing, every output kind, errors, parity with torch."""

import math

import numpy as np
import onnx
import pytest
import torch
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st

from palpate.data.depth.model import DepthModel, place, preprocess
from palpate.data.depth.normalise import DepthSettings, estimate_scale, open_depth
from palpate.data.depth.preset import PRESET_FOLDER, DepthPreset, load_preset
from palpate.data.source.layout import ClipLayout, InputError
from tests.data.clips import Pictures
from tests.networks import write_network

HEIGHT, WIDTH = 48, 80
GREY = np.broadcast_to(np.linspace(51, 204, WIDTH).round().astype(np.uint8)[:, None], (HEIGHT, WIDTH, 3))
"""A ramp from 0.2 to 0.8 across the picture."""
DARKER = (GREY * 0.8).round().astype(np.uint8)
LEVELS = GREY[..., 0].astype(np.float64) / 255
FIELD_OF_VIEW = {"kind": "canonical_inverse", "output": "depth", "focal_output": "focal", "focal_kind": "fov_deg"}
LETTERBOX = {"kind": "metric", "size": [100, 80], "letterbox": True}


def build(path, *, gain=1.0, bias=0.0, shape=(1, 3, "h", "w"), focal=None, rank=4, scale=1):
    """An ONNX file whose output is gain·(mean over channels) + bias, perhaps with a constant focal length."""
    graph = f"""tiny (float[{", ".join(map(str, shape))}] image) =>
        (float[{", ".join("?" * rank)}] depth{"" if focal is None else ", float[1] focal"}) {{
        mean = ReduceMean<keepdims={int(rank == 4)}>(image, axis)
        scaled = Mul(mean, gain)
        full = Add(scaled, bias)
        depth = {"Identity(full)" if scale == 1 else 'Resize<mode="nearest">(full, , sizes)'}
        {"" if focal is None else "focal = Identity(length)"}
    }}"""
    constants = {"axis": np.array([shape.index(3)]), "gain": np.array(gain, np.float32)}
    constants |= {"bias": np.array(bias, np.float32), "sizes": np.array([1, 1, scale, scale], np.float32)}
    return write_network(path, graph, **constants, length=np.array([focal or 0], np.float32))


def opened(tmp_path, preset: dict, pictures=(GREY,), layout: ClipLayout | None = None, **network):
    """Depth source of a tiny network beside its preset file; pictures keep their size where the preset has none."""
    settings = {name: network.pop(name) for name in ("near", "far", "threads", "field_of_view_deg") if name in network}
    path = build(tmp_path / "tiny.onnx", **network)
    path.with_suffix(".yaml").write_text(yaml.safe_dump(preset if "size" in preset else {"resize": "none"} | preset))
    chosen, source = DepthSettings(source=str(path), **settings), Pictures(pictures)
    return open_depth(chosen, layout or ClipLayout(), source), source, chosen


def depth_of(tmp_path, preset: dict, **options) -> np.ndarray:
    depth, source, _ = opened(tmp_path, preset, **options)
    return depth(next(iter(source)))


# Size and position


@pytest.mark.parametrize(
    ("name", "picture", "expected"),
    [
        ("depthpro", (480, 854), (1536, 1536)),
        ("depth-anything-v2", (480, 854), (518, 924)),
        ("depth-anything-v2", (540, 740), (518, 714)),
        ("midas-small", (480, 854), (128, 256)),
        ("midas-small", (256, 256), (256, 256)),
        ("metric3d", (480, 854), (616, 1064)),
    ],
)
def test_input_size_of_each_network(name, picture, expected):
    placement = place(*picture, load_preset(name))
    assert (placement.height, placement.width) == expected
    if name == "metric3d":
        # 854x480 fits 1064x616 by 1064/854 = 1.2459: 1064x598, 9 rows above and 9 below.
        assert (placement.rows, placement.columns, placement.top, placement.left) == (598, 1064, 9, 0)


@settings(max_examples=40)
@given(
    height=st.integers(16, 1200),
    width=st.integers(16, 2000),
    name=st.sampled_from(["depth-anything-v2", "midas-small"]),
)
def test_sizes_are_multiples_and_keep_the_aspect(height, width, name):
    preset = load_preset(name)
    placement = place(height, width, preset)
    sides = (placement.rows, placement.columns)
    assert all(side % preset.multiple == 0 and side >= preset.multiple for side in sides)
    if preset.resize == "longer":
        assert max(sides) <= preset.size
    ratio = preset.size / (min(height, width) if preset.resize == "shorter" else max(height, width))
    for side, original in zip(sides, (height, width), strict=True):
        assert abs(side - original * ratio) <= preset.multiple


# Preprocessing


def test_preprocessing_is_scale_mean_std_in_the_presets_order():
    picture = np.full((4, 6, 3), (255, 51, 0), np.uint8)
    preset = DepthPreset(name="a", kind="metric", resize="none", mean=(0.5, 0.1, 0.2), std=(0.5, 0.2, 0.1))
    tensor = preprocess(picture, preset, place(4, 6, preset))
    assert tensor.shape == (1, 3, 4, 6)
    assert tensor[0, :, 0, 0] == pytest.approx([1.0, 0.5, -2.0], rel=1e-5)
    other = DepthPreset(name="a", kind="metric", resize="none", value_scale=255, layout="NHWC", channels="BGR")
    tensor = preprocess(picture, other, place(4, 6, other))
    assert (tensor.shape, tensor[0, 0, 0].tolist()) == ((1, 4, 6, 3), [0, 51, 255])


# Output kinds, and geometry of the output


@pytest.mark.parametrize(
    ("preset", "network", "expected"),
    [
        ({"kind": "metric", "factor": 0.5}, {"gain": 2.0, "bias": 1.0}, 0.5 * (2 * LEVELS + 1)),
        ({"kind": "relative", "factor": 0.5}, {"gain": 2.0, "bias": 1.0}, 0.5 * (2 * LEVELS + 1)),
        ({"kind": "inverse"}, {"gain": 4.0}, 1 / (4 * LEVELS)),
        ({"kind": "metric"}, {"rank": 3}, LEVELS),
        ({"kind": "metric"}, {"rank": 4}, LEVELS),
        ({"kind": "metric", "layout": "NHWC", "channels": "BGR"}, {"shape": (1, "h", "w", 3), "rank": 3}, LEVELS),
        (LETTERBOX | {"letterbox_value": [255, 255, 255]}, {}, LEVELS),
    ],
    ids=["metric", "relative", "inverse", "no channel axis", "channel axis", "channels last", "letterbox"],
)
def test_depth_is_what_the_preset_makes_of_the_output(tmp_path, preset, network, expected):
    np.testing.assert_allclose(depth_of(tmp_path, preset, **network), expected, rtol=1e-5)


def test_an_output_of_another_resolution_is_brought_to_the_picture(tmp_path):
    depth = depth_of(tmp_path, LETTERBOX, scale=0.5)
    assert depth.shape == (HEIGHT, WIDTH)
    np.testing.assert_allclose(depth[:, 4:-4], LEVELS[:, 4:-4], rtol=0, atol=0.01)


def test_canonical_inverse_depth_with_a_field_of_view(tmp_path):
    depth, source, settings = opened(tmp_path, FIELD_OF_VIEW, focal=90.0)
    # 90 degrees: f = w/2, so D = 0.5/C.
    np.testing.assert_allclose(depth(next(iter(source))), 0.5 / LEVELS, rtol=1e-5)
    assert (depth.focal, estimate_scale(source, depth, settings)[1]) == (pytest.approx(0.5), pytest.approx(WIDTH / 2))


@pytest.mark.parametrize("focal", [0.0, -19.4, math.nan, math.inf])
def test_an_unusable_focal_length_falls_back_to_the_field_of_view(tmp_path, focal):
    depth, source, _ = opened(tmp_path, FIELD_OF_VIEW, field_of_view_deg=60.0, focal=focal)
    map_ = depth(next(iter(source)))
    assert depth.focal is None
    np.testing.assert_allclose(map_, 0.5 / math.tan(math.radians(30)) / LEVELS, rtol=1e-5)


def test_canonical_camera_is_scaled_by_the_resized_focal_length(tmp_path):
    preset = {"kind": "metric", "canonical_focal_px": 1000, "size": [2 * HEIGHT, 2 * WIDTH]}
    depth = depth_of(tmp_path, preset, field_of_view_deg=90.0)
    # f at the input's width of 160 px is 80 px, so D = 0.08·D̂.
    np.testing.assert_allclose(depth[:, 5:-5], 0.08 * LEVELS[:, 5:-5], rtol=3e-3)


def test_camera_file_decides_over_the_default_field_of_view(tmp_path):
    camera = {"fx": 100.0, "fy": 100.0, "cx": 40.0, "cy": 24.0, "width": WIDTH, "height": HEIGHT}
    (tmp_path / "camera.yaml").write_text(yaml.safe_dump(camera))
    layout = ClipLayout(camera=str(tmp_path / "camera.yaml"))
    depth = depth_of(tmp_path, {"kind": "canonical_inverse"}, layout=layout)
    np.testing.assert_allclose(depth, 100 / WIDTH / LEVELS, rtol=1e-5)


def test_relative_inverse_depth_keeps_one_range_for_the_clip(tmp_path):
    pictures = [GREY, GREY, DARKER]
    depth, source, chosen = opened(tmp_path, {"kind": "relative_inverse"}, pictures, near=0.05, far=0.2)
    estimate_scale(source, depth, chosen)
    maps = [depth(frame) for frame in source]
    # Medians of the three frames' ends: 0.2 and 0.8, so 1/D = 5 + 15·(r − 0.2)/0.6.
    np.testing.assert_allclose(maps[0], 1 / (5 + 25 * (LEVELS - LEVELS.min())), rtol=5e-3)
    assert np.array_equal(maps[0], maps[1])
    # The darker frame is not stretched to near and far: its flicker shows.
    share = np.maximum(DARKER[..., 0] / 255 - 0.2, 0)
    np.testing.assert_allclose(maps[2], 1 / (5 + 25 * share), rtol=5e-3)


def test_focal_length_is_the_median_of_the_clip_and_then_fixed(tmp_path):
    """A network whose focal length follows the picture: depth must not flicker with it."""
    graph = """tiny (float[1, 3, h, w] image) => (float[1, 1, h, w] depth, float focal)
        <int64[1] channels = {1}, float hundred = {100}> {
        depth = ReduceMean(image, channels)
        top = ReduceMax<keepdims=0>(image)
        focal = Mul(top, hundred)
    }"""
    path = write_network(tmp_path / "tiny.onnx", graph)
    path.with_suffix(".yaml").write_text(
        "kind: canonical_inverse\nresize: none\noutput: depth\nfocal_output: focal\nfocal_grid: 100\n"
    )
    pictures = [np.minimum(GREY, 102) for _ in range(3)]
    for picture, top in zip(pictures, (102, 204, 255), strict=True):
        picture[0, 0] = top
    source, settings = Pictures(pictures), DepthSettings(source=str(path))
    depth = open_depth(settings, ClipLayout(), source)
    _, focal = estimate_scale(source, depth, settings)
    assert focal == pytest.approx(0.8 * WIDTH)
    maps = [depth(frame) for frame in source]
    assert depth.focal == pytest.approx(0.8)
    assert np.array_equal(maps[0][1:], maps[2][1:])


@pytest.mark.parametrize(
    ("network", "expected"),
    [
        ({"gain": math.nan}, "is NaN or infinite everywhere"),
        ({"gain": 0.0}, "is zero everywhere"),
        ({"gain": 0.0, "bias": 2.0}, r"is the same everywhere \(2\)"),
        ({"gain": -1.0}, "is valid on 0.0% of its pixels"),
    ],
)
def test_a_frame_without_depth_is_told(tmp_path, network, expected):
    with pytest.raises(InputError, match=f"tiny.onnx for frame 0 {expected}"):
        depth_of(tmp_path, {"kind": "metric"}, **network)


def test_only_the_bad_frame_is_bad(tmp_path):
    depth, source, settings = opened(tmp_path, {"kind": "metric"}, [GREY, np.zeros_like(GREY), GREY])
    assert estimate_scale(source, depth, settings)[0] == pytest.approx(0.8, rel=0.05)
    frames = list(source)
    with pytest.raises(InputError):
        depth(frames[1])
    assert np.array_equal(depth(frames[0]), depth(frames[2]))


# Files that don't fit


@pytest.mark.parametrize(
    ("preset", "network", "expected"),
    [
        ({"output": ["a", "b"]}, {}, "has the outputs depth, and not a or b"),
        ({"output": "depth", "focal_output": "fov"}, {"focal": 1.0}, "has the outputs depth, focal, and not"),
        ({}, {"focal": 1.0}, "has the outputs depth, focal, and not one alone"),
        ({"size": [32, 32]}, {"shape": (1, 3, 48, 80)}, "takes pictures of 48x80"),
        ({}, {"shape": (1, 3, 5000, 80)}, "takes pictures of 5000x80; export it for 1 to 4096."),
        ({}, {"shape": (1, 3, 0, 80)}, "takes pictures of 0x80; export it for 1 to 4096."),
        ({"layout": "NHWC"}, {"shape": (1, 3, 48, 80)}, "and not one colour picture as NHWC"),
        ({}, {"shape": (2, 3, "h", "w")}, "takes 2 pictures at once; export it with a batch of 1"),
        ({}, {"shape": ("h", 3), "rank": 1}, "and not one colour picture"),
    ],
)
def test_other_inputs_or_outputs_than_the_preset_says(tmp_path, preset, network, expected):
    with pytest.raises(InputError, match=r"tiny\.onnx") as caught:
        opened(tmp_path, {"kind": "metric", **preset}, **network)
    assert expected in str(caught.value)


@pytest.mark.parametrize(
    ("graph", "expected"),
    [
        (
            "(float[1, 3, h, w] a, float[1, 3, h, w] b) => (float[1, 3, h, w] depth) { depth = Add(a, b) }",
            r"it.onnx takes a .*, b .*, and not one colour picture",
        ),
        (
            "(float[1, 3, h, w] image) => (float[1, 3, h, w] depth) { depth = Identity(image) }",
            r"'depth' of shape \[1, 3, 48, 80\], which is not one depth map",
        ),
    ],
    ids=["two inputs", "no map"],
)
def test_a_network_from_something_else_or_to_something_else_is_named(tmp_path, graph, expected):
    path = write_network(tmp_path / "it.onnx", f"g {graph}")
    with pytest.raises(InputError, match=expected):
        DepthModel(path, DepthPreset(name="a", kind="metric", resize="none")).raw(GREY)


def test_a_device_that_is_not_there_is_named(tmp_path):
    import onnxruntime

    if "CUDAExecutionProvider" in onnxruntime.get_available_providers():
        pytest.skip("this onnxruntime has CUDA")
    with pytest.raises(InputError, match=r"device cuda is not in this onnxruntime; install onnxruntime-gpu"):
        DepthModel(build(tmp_path / "tiny.onnx"), DepthPreset(name="a", kind="metric"), device="cuda")


def test_identity_follows_model_preset_and_settings(tmp_path):
    changes = ({}, {}, {"gain": 2.0}, {"factor": 2.0}, {"far": 0.3})
    found = []
    for change in changes:
        preset = {"kind": "inverse", "factor": change.pop("factor", 1.0)}
        found.append(opened(tmp_path, preset, **change)[0].identity)
    assert found[0] == found[1]
    assert len(set(found)) == 4


# The published architectures, tiny and random, exported as their presets expect


class Giving(torch.nn.Module):
    """What `outputs` makes of another network's result."""

    def __init__(self, network, outputs):
        super().__init__()
        self.network, self.outputs = network, outputs

    def forward(self, pixel_values):
        return self.outputs(self.network(pixel_values))


def export(module, example, path, outputs):
    """Write a torch module as ONNX with the input `pixel_values`."""
    names = {"input_names": ["pixel_values"], "output_names": outputs}
    torch.onnx.export(module.eval(), (example,), str(path), dynamo=False, opset_version=18, verbose=False, **names)


def rename_outputs(path, target, names: dict[str, str]) -> None:
    """Copy a model with some of its outputs, under other names."""
    model = onnx.load(str(path))
    for node in model.graph.node:
        node.output[:] = [names.get(name, name) for name in node.output]
        node.input[:] = [names.get(name, name) for name in node.input]
    kept = [output for output in model.graph.output if output.name in names]
    del model.graph.output[:]
    model.graph.output.extend(kept)
    for output in model.graph.output:
        output.name = names[output.name]
    onnx.save(model, str(target))


SMALL = {"hidden_size": 16, "num_attention_heads": 2, "intermediate_size": 32}
"""Size of a vision transformer."""


def enliven(network) -> None:
    """Weights large enough that the random network's output follows its input."""
    with torch.no_grad():
        for parameter in network.parameters():
            if parameter.dim() > 1:
                parameter.normal_(0, 1 / math.sqrt(parameter[0].numel()))


def smooth_picture(width: int) -> np.ndarray:
    rows, columns = np.mgrid[:480, :width]
    waves = [np.sin(columns / 60), np.cos(rows / 45), np.sin((rows + columns) / 80)]
    return np.stack([127 + 100 * wave for wave in waves], axis=-1).astype(np.uint8)


def enlarged(values, image: np.ndarray) -> np.ndarray:
    """Torch's bilinear resize to the picture's size."""
    return torch.nn.functional.interpolate(values[:, None], size=image.shape[:2], mode="bilinear")[0, 0].numpy()


def depth_by(preset, path, image: np.ndarray, **settings):
    """The source of a file and its preset, and its depth of a picture."""
    source = Pictures([image])
    depth = open_depth(DepthSettings(str(path), preset=str(preset), **settings), ClipLayout(), source)
    return depth, depth(next(iter(source)))


@pytest.mark.acceptance
@pytest.mark.filterwarnings("ignore")
def test_depthpro_by_both_of_its_presets(tmp_path):
    """On a grid of a quarter of its size."""
    transformers = pytest.importorskip("transformers")
    torch.manual_seed(0)
    vit = SMALL | {"model_type": "dinov2", "num_hidden_layers": 2, "image_size": 96, "patch_size": 16}
    encoders = dict.fromkeys(("image_model_config", "patch_model_config", "fov_model_config"), vit)
    sizes = {"fusion_hidden_size": 8, "intermediate_hook_ids": [1, 0], "intermediate_feature_dims": [8, 8]}
    sizes |= {"patch_size": 96, "scaled_images_feature_dims": [16, 16, 8], "use_fov_model": True}
    network = transformers.DepthProForDepthEstimation(transformers.DepthProConfig(**encoders, **sizes)).eval()
    enliven(network)
    with torch.no_grad():
        network.fov_model.head.layers[-1].bias.fill_(70.0)

    def outputs(result):
        """Canonical inverse depth with its field of view, and what the published files give instead."""
        focal = 0.5 * 384 / torch.tan(math.radians(0.5) * result.field_of_view)
        metres = focal / (384 * result.predicted_depth.clamp(1e-4, 1e4))
        return result.predicted_depth, result.field_of_view, metres, focal

    canonical_preset, metric_preset = (tmp_path / f"{name}.yaml" for name in ("depthpro-canonical", "depthpro"))
    for path in (canonical_preset, metric_preset):
        path.write_text((PRESET_FOLDER / path.name).read_text().replace("1536", "384"))
    image, preset = smooth_picture(854), load_preset(canonical_preset)
    tensor = torch.from_numpy(preprocess(image, preset, place(480, 854, preset)))
    both, module = tmp_path / "both.onnx", Giving(network, outputs)
    export(module, tensor, both, ["canonical", "fov", "metres", "focal"])
    rename_outputs(both, tmp_path / "a.onnx", {"canonical": "predicted_depth", "fov": "field_of_view"})
    rename_outputs(both, tmp_path / "b.onnx", {"metres": "predicted_depth", "focal": "focallength_px"})
    with torch.no_grad():
        canonical, fov, metres, _ = module(tensor)
    assert 0 < float(fov) < 180
    focal = 0.5 * 854 / math.tan(math.radians(float(fov)) / 2)

    depth, map_ = depth_by(canonical_preset, tmp_path / "a.onnx", image)
    inverse = enlarged(canonical, image)
    usable = inverse > 0.01 * inverse.max()
    assert usable.mean() > 0.5
    assert 854 * depth.focal == pytest.approx(focal, rel=1e-4)
    np.testing.assert_allclose(focal / 854 / map_[usable], inverse[usable], rtol=0, atol=1e-4 * inverse.max())

    depth, map_ = depth_by(metric_preset, tmp_path / "b.onnx", image)
    assert depth.metres is not None
    assert depth.metres[:2] == (1.0, 0.0)
    assert 854 * depth.focal == pytest.approx(focal, rel=1e-4)
    expected = enlarged(metres, image)
    # Near C = 0 metres magnify float noise, so the tolerance is wider than for C itself.
    assert (np.abs(map_ - expected) <= np.maximum(1e-2 * expected, 1e-4 * expected.max())).all()

    with pytest.raises(InputError, match=r"a.onnx has the outputs .*field_of_view, and not focallength_px"):
        depth_by(metric_preset, tmp_path / "a.onnx", image)


@pytest.mark.acceptance
@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize(("kind", "name"), [("relative", "depth-anything-v2"), ("metric", "depth-anything-v2-metric")])
def test_depth_anything(tmp_path, kind, name):
    transformers = pytest.importorskip("transformers")
    torch.manual_seed(0)
    shape = SMALL | {"num_hidden_layers": 4, "image_size": 518, "patch_size": 14, "out_indices": [1, 2, 3, 4]}
    sizes = {"reassemble_hidden_size": 16, "neck_hidden_sizes": [8, 8, 8, 8], "fusion_hidden_size": 8}
    config = transformers.DepthAnythingConfig(
        backbone_config=transformers.Dinov2Config(**shape, apply_layernorm=True, reshape_hidden_states=False),
        **sizes,
        head_hidden_size=8,
        depth_estimation_type=kind,
        max_depth=20 if kind == "metric" else 1,
    )
    network = transformers.DepthAnythingForDepthEstimation(config).eval()
    enliven(network)
    with torch.no_grad():
        network.head.conv3.bias.fill_(0.5)

    module, preset = Giving(network, lambda result: result.predicted_depth), load_preset(name)
    image = smooth_picture(640)
    tensor = torch.from_numpy(preprocess(image, preset, place(480, 640, preset)))
    assert tensor.shape == (1, 3, 518, 686)
    export(module, tensor, tmp_path / "x.onnx", ["predicted_depth"])
    with torch.no_grad():
        expected = enlarged(module(tensor), image)
    depth, result = depth_by(name, tmp_path / "x.onnx", image, near=0.05, far=0.2)
    if kind == "relative":
        low, high = np.quantile(expected, [0.001, 0.999])
        share = np.maximum((expected - low) / (high - low), 0)
        expected = 1 / (5 + 15 * share)
    assert (depth.metres is not None) == (kind == "metric")
    np.testing.assert_allclose(result, expected, rtol=2e-3)
