"""ONNX depth networks through the preset path: sizes, preprocessing, every output kind, errors, parity with torch."""

import math
from pathlib import Path

import numpy as np
import onnx
import pytest
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st

from palpate.data.depth.model import DepthModel, place, preprocess
from palpate.data.depth.normalise import DepthSettings, estimate_scale, open_depth
from palpate.data.depth.preset import DepthPreset, load_preset
from palpate.data.source.frames import Frame, FrameSource
from palpate.data.source.layout import ClipLayout, InputError
from tests.networks import write_network

HEIGHT, WIDTH = 48, 80
GREY = np.broadcast_to(np.linspace(51, 204, WIDTH).round().astype(np.uint8)[:, None], (HEIGHT, WIDTH, 3))
"""A ramp from 0.2 to 0.8 across the picture."""


class Pictures(FrameSource):
    """A clip of given pictures."""

    def __init__(self, pictures) -> None:
        self.name, self.path, self.fps, self.warnings = "clip", Path("clip.mp4"), 10.0, []
        self.pictures, self.length = list(pictures), len(pictures)
        self.size = self.pictures[0].shape[1::-1]

    def __iter__(self):
        for index, picture in enumerate(self.pictures):
            yield Frame(index, index, index / self.fps, picture)


def build(path, *, gain=1.0, bias=0.0, shape=(1, 3, "h", "w"), names=("image", "depth"), focal=None, rank=4, scale=1):
    """An ONNX file whose output is gain·(mean over channels) + bias, perhaps with a constant focal length."""
    (image, depth), made = names, ", ".join("?" * rank)
    graph = f"""tiny (float[{", ".join(map(str, shape))}] {image}) =>
        (float[{made}] {depth}{", float[1] focal" if focal is not None else ""}) {{
        mean = ReduceMean<keepdims={int(rank == 4)}>({image}, axis)
        scaled = Mul(mean, gain)
        full = Add(scaled, bias)
        {depth} = {'Resize<mode="nearest">(full, , sizes)' if scale != 1 else "Identity(full)"}
        {"focal = Identity(length)" if focal is not None else ""}
    }}"""
    constants = {"axis": np.array([shape.index(3)]), "gain": np.float32(gain), "bias": np.float32(bias)}
    if scale != 1:
        constants["sizes"] = np.array([1, 1, scale, scale], np.float32)
    if focal is not None:
        constants["length"] = np.array([focal], np.float32)
    return write_network(path, graph, **{name: np.asarray(value) for name, value in constants.items()})


def opened(tmp_path, preset: dict, pictures=(GREY,), settings: dict | None = None, **network):
    """Depth source of a tiny network beside its preset file."""
    path = build(tmp_path / "tiny.onnx", **network)
    path.with_suffix(".yaml").write_text(yaml.safe_dump(preset))
    chosen = DepthSettings(source=str(path), **(settings or {}))
    source = Pictures(pictures)
    return open_depth(chosen, ClipLayout(), source), source, chosen


def depth_of(tmp_path, preset: dict, **network) -> np.ndarray:
    depth, source, _ = opened(tmp_path, {"resize": "none", **preset}, **network)
    return depth(next(iter(source)))


LEVELS = GREY[..., 0].astype(np.float64) / 255


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
        ("photometric", (480, 854), (240, 428)),
    ],
)
def test_input_size_of_each_network(name, picture, expected):
    placement = place(*picture, load_preset(name))
    assert (placement.height, placement.width) == expected


def test_letterbox_is_centred():
    placement = place(480, 854, load_preset("metric3d"))
    # 854x480 fits 1064x616 by 1064/854 = 1.2459: 1064x598, 9 rows above and 9 below.
    assert (placement.rows, placement.columns, placement.top, placement.left) == (598, 1064, 9, 0)


def test_a_model_files_own_size_is_taken():
    placement = place(480, 854, load_preset("depth-anything-v2"), (518, 518))
    assert (placement.height, placement.width, placement.rows, placement.columns) == (518, 518, 518, 518)


@settings(max_examples=40)
@given(
    height=st.integers(16, 1200),
    width=st.integers(16, 2000),
    name=st.sampled_from(["depth-anything-v2", "midas-small", "photometric"]),
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
    assert tensor.shape == (1, 4, 6, 3)
    assert tensor[0, 0, 0].tolist() == [0, 51, 255]


def test_enlarging_is_torchs_bilinear():
    torch = pytest.importorskip("torch")
    picture = np.random.default_rng(0).integers(0, 256, (30, 40, 3), np.uint8)
    preset = DepthPreset(name="a", kind="metric", size=(64, 96))
    tensor = preprocess(picture, preset, place(30, 40, preset))
    reference = torch.nn.functional.interpolate(
        torch.from_numpy(picture).permute(2, 0, 1)[None].float() / 255, size=(64, 96), mode="bilinear"
    )
    assert tensor == pytest.approx(reference.numpy(), abs=1e-5)


def test_shrinking_averages_areas():
    picture = np.random.default_rng(0).integers(0, 256, (8, 12, 3), np.uint8)
    preset = DepthPreset(name="a", kind="metric", size=(2, 3), value_scale=255)
    tensor = preprocess(picture, preset, place(8, 12, preset))
    assert tensor[0, 0] == pytest.approx(picture[..., 0].reshape(2, 4, 3, 4).mean(axis=(1, 3)), rel=1e-5)


# Output kinds


@pytest.mark.parametrize("kind", ["metric", "relative"])
def test_depth_as_it_is_with_a_factor(tmp_path, kind):
    depth = depth_of(tmp_path, {"kind": kind, "factor": 0.5}, gain=2.0, bias=1.0)
    assert depth == pytest.approx(0.5 * (2 * LEVELS + 1), rel=1e-5)


def test_inverse_depth(tmp_path):
    assert depth_of(tmp_path, {"kind": "inverse"}, gain=4.0) == pytest.approx(1 / (4 * LEVELS), rel=1e-5)


def test_canonical_inverse_depth_with_a_field_of_view(tmp_path):
    preset = {"kind": "canonical_inverse", "output": "depth", "focal_output": "focal", "focal_kind": "fov_deg"}
    depth, source, settings = opened(tmp_path, {"resize": "none", **preset}, focal=90.0)
    # 90 degrees: f = w/2, so D = 0.5/C.
    assert depth(next(iter(source))) == pytest.approx(0.5 / LEVELS, rel=1e-5)
    assert depth.focal == pytest.approx(0.5)
    assert estimate_scale(source, depth, settings)[1] == pytest.approx(WIDTH / 2)


def test_focal_length_on_its_own_grid(tmp_path):
    preset = {"kind": "metric", "output": "depth", "focal_output": "focal", "focal_grid": 1536, "size": [16, 16]}
    depth, source, settings = opened(tmp_path, preset, focal=1330.0)
    assert estimate_scale(source, depth, settings)[1] == pytest.approx(1330.0 * WIDTH / 1536)


@pytest.mark.parametrize("focal", [0.0, -19.4, math.nan, math.inf])
def test_an_unusable_focal_length_falls_back_to_the_field_of_view(tmp_path, focal):
    preset = {"kind": "canonical_inverse", "output": "depth", "focal_output": "focal", "focal_kind": "fov_deg"}
    depth, source, _ = opened(tmp_path, {"resize": "none", **preset}, settings={"field_of_view_deg": 60.0}, focal=focal)
    map_ = depth(next(iter(source)))
    assert depth.focal is None
    assert map_ == pytest.approx(0.5 / math.tan(math.radians(30)) / LEVELS, rel=1e-5)


def test_canonical_camera_is_scaled_by_the_resized_focal_length(tmp_path):
    preset = {"kind": "metric", "canonical_focal_px": 1000, "size": [2 * HEIGHT, 2 * WIDTH]}
    depth, source, _ = opened(tmp_path, preset, settings={"field_of_view_deg": 90.0})
    # f at the input's width of 160 px is 80 px, so D = 0.08·D̂.
    assert depth(next(iter(source)))[:, 5:-5] == pytest.approx(0.08 * LEVELS[:, 5:-5], rel=3e-3)


def test_camera_file_decides_over_the_default_field_of_view(tmp_path):
    camera = {"fx": 100.0, "fy": 100.0, "cx": 40.0, "cy": 24.0, "width": WIDTH, "height": HEIGHT}
    (tmp_path / "camera.yaml").write_text(yaml.safe_dump(camera))
    path = build(tmp_path / "tiny.onnx")
    path.with_suffix(".yaml").write_text("kind: canonical_inverse\nresize: none\n")
    source = Pictures([GREY])
    layout = ClipLayout(camera=str(tmp_path / "camera.yaml"))
    depth = open_depth(DepthSettings(source=str(path)), layout, source)
    assert depth(next(iter(source))) == pytest.approx(100 / WIDTH / LEVELS, rel=1e-5)


def test_relative_inverse_depth_keeps_one_range_for_the_clip(tmp_path):
    darker = (GREY * 0.8).round().astype(np.uint8)
    pictures = [GREY, GREY, darker]
    settings = {"near": 0.05, "far": 0.2}
    depth, source, chosen = opened(tmp_path, {"kind": "relative_inverse", "resize": "none"}, pictures, settings)
    estimate_scale(source, depth, chosen)
    maps = [depth(frame) for frame in source]
    # Medians of the three frames' ends: 0.2 and 0.8, so 1/D = 5 + 15·(r − 0.2)/0.6.
    assert maps[0] == pytest.approx(1 / (5 + 25 * (LEVELS - LEVELS.min())), rel=5e-3)
    assert np.array_equal(maps[0], maps[1])
    # The darker frame is not stretched to near and far: its flicker shows.
    share = np.maximum(darker[..., 0] / 255 - 0.2, 0)
    assert maps[2] == pytest.approx(1 / (5 + 25 * share), rel=5e-3)


def test_without_a_scale_the_first_frame_freezes_the_range(tmp_path):
    pictures = [GREY, (GREY * 0.8).round().astype(np.uint8)]
    depth, source, _ = opened(tmp_path, {"kind": "relative_inverse", "resize": "none"}, pictures)
    first, second = (depth(frame) for frame in source)
    assert first.min() == pytest.approx(0.03, rel=1e-2)
    assert second.min() > 1.1 * first.min()


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
    pictures = []
    for top in (102, 204, 255):
        picture = GREY.copy()
        picture[0, 0] = top
        picture[:, WIDTH // 2 :] = np.minimum(picture[:, WIDTH // 2 :], 102)
        pictures.append(picture)
    source = Pictures(pictures)
    settings = DepthSettings(source=str(path))
    depth = open_depth(settings, ClipLayout(), source)
    _, focal = estimate_scale(source, depth, settings)
    assert focal == pytest.approx(0.8 * WIDTH)
    maps = [depth(frame) for frame in source]
    assert depth.focal == pytest.approx(0.8)
    assert np.array_equal(maps[0][1:], maps[2][1:])


# Geometry of the output


def test_letterbox_is_cropped_from_the_output(tmp_path):
    preset = {"kind": "metric", "size": [100, 80], "letterbox": True, "letterbox_value": [255, 255, 255]}
    depth = depth_of(tmp_path, {**preset, "resize": "exact"})
    assert depth == pytest.approx(LEVELS, rel=1e-5)


def test_an_output_of_another_resolution_is_brought_to_the_picture(tmp_path):
    preset = {"kind": "metric", "size": [100, 80], "letterbox": True}
    depth = depth_of(tmp_path, {**preset, "resize": "exact"}, scale=0.5)
    assert depth.shape == (HEIGHT, WIDTH)
    assert depth[:, 4:-4] == pytest.approx(LEVELS[:, 4:-4], abs=0.01)


@pytest.mark.parametrize("rank", [3, 4])
def test_outputs_with_and_without_a_channel_axis(tmp_path, rank):
    assert depth_of(tmp_path, {"kind": "metric"}, rank=rank) == pytest.approx(LEVELS, rel=1e-5)


def test_channels_last(tmp_path):
    preset = {"kind": "metric", "layout": "NHWC", "channels": "BGR"}
    assert depth_of(tmp_path, preset, shape=(1, "h", "w", 3), rank=3) == pytest.approx(LEVELS, rel=1e-5)


def test_partial_validity_and_bad_frames(tmp_path):
    # gain·x + bias crosses zero at x = 0.5: negative depth there is invalid.
    depth = depth_of(tmp_path, {"kind": "metric"}, gain=2.0, bias=-1.0)
    assert np.array_equal(depth > 0, LEVELS > 0.5)
    source_of = {"resize": "none", "kind": "metric"}
    for network, expected in (
        ({"gain": math.nan}, "is NaN or infinite everywhere"),
        ({"gain": 0.0}, "is zero everywhere"),
        ({"gain": 0.0, "bias": 2.0}, r"is the same everywhere \(2\)"),
        ({"gain": -1.0}, "is valid on 0.0% of its pixels"),
    ):
        depth, source, _ = opened(tmp_path, source_of, **network)
        with pytest.raises(InputError, match=f"tiny.onnx for frame 0 {expected}"):
            depth(next(iter(source)))


def test_only_the_bad_frame_is_bad(tmp_path):
    depth, source, settings = opened(tmp_path, {"kind": "metric", "resize": "none"}, [GREY, np.zeros_like(GREY), GREY])
    assert estimate_scale(source, depth, settings)[0] == pytest.approx(0.8, rel=0.05)
    frames = list(source)
    with pytest.raises(InputError):
        depth(frames[1])
    assert np.array_equal(depth(frames[0]), depth(frames[2]))


# Files that don't fit


def test_what_is_no_onnx_model_is_named(tmp_path):
    path = tmp_path / "x.onnx"
    for content in (b"", b"not a model", b"\x00" * 100):
        path.write_bytes(content)
        with pytest.raises(InputError, match=r"x.onnx can't be opened as an ONNX model") as caught:
            DepthModel(path, DepthPreset(name="a", kind="metric"))
        assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("preset", "network", "expected"),
    [
        ({"output": ["a", "b"]}, {}, "has the outputs depth, and not a or b"),
        ({"output": "depth", "focal_output": "fov"}, {"focal": 1.0}, "has the outputs depth, focal, and not"),
        ({}, {"focal": 1.0}, "has the outputs depth, focal, and not one alone"),
        ({"size": [32, 32]}, {"shape": (1, 3, 48, 80)}, "takes pictures of 48x80"),
        ({"layout": "NHWC"}, {"shape": (1, 3, 48, 80)}, "and not one colour picture as NHWC"),
        ({}, {"shape": (2, 3, "h", "w")}, "and not one colour picture as NCHW"),
        ({}, {"shape": ("h", 3), "rank": 1}, "and not one colour picture"),
    ],
)
def test_other_inputs_or_outputs_than_the_preset_says(tmp_path, preset, network, expected):
    with pytest.raises(InputError, match=r"tiny\.onnx") as caught:
        opened(tmp_path, {"kind": "metric", **preset}, **network)
    assert expected in str(caught.value)


def test_two_inputs_are_refused(tmp_path):
    graph = "g (float[1, 3, h, w] a, float[1, 3, h, w] b) => (float[1, 3, h, w] depth) { depth = Add(a, b) }"
    path = write_network(tmp_path / "two.onnx", graph)
    with pytest.raises(InputError, match=r"two.onnx takes a .*, b .*, and not one colour picture"):
        DepthModel(path, DepthPreset(name="a", kind="metric"))


def test_an_output_that_is_no_map_is_named(tmp_path):
    graph = "g (float[1, 3, h, w] image) => (float[1, 3, h, w] depth) { depth = Identity(image) }"
    path = write_network(tmp_path / "same.onnx", graph)
    network = DepthModel(path, DepthPreset(name="a", kind="metric", resize="none"))
    with pytest.raises(InputError, match=r"'depth' of shape \[1, 3, 48, 80\], which is not one depth map"):
        network.raw(GREY)


def test_a_device_that_is_not_there_is_named(tmp_path):
    import onnxruntime

    if "CUDAExecutionProvider" in onnxruntime.get_available_providers():
        pytest.skip("this onnxruntime has CUDA")
    with pytest.raises(InputError, match=r"depth\.device cuda is not in this onnxruntime"):
        DepthModel(build(tmp_path / "tiny.onnx"), DepthPreset(name="a", kind="metric"), device="cuda")


def test_identity_follows_model_preset_and_settings(tmp_path):
    def identity(preset=None, settings=None, **network):
        return opened(tmp_path, {"kind": "inverse", **(preset or {})}, settings=settings, **network)[0].identity

    first = identity()
    assert identity() == first
    others = {identity(gain=2.0), identity({"factor": 2.0}), identity(settings={"far": 0.3})}
    assert len(others | {first}) == 4


def test_threads_do_not_change_the_result(tmp_path):
    one, source, _ = opened(tmp_path, {"kind": "metric"}, settings={"threads": 1})
    two, _, _ = opened(tmp_path, {"kind": "metric"}, settings={"threads": 2})
    frame = next(iter(source))
    assert np.array_equal(one(frame), two(frame))


# The published architectures, tiny and random, exported as their presets expect


def giving(network, outputs):
    """A network that gives what `outputs` makes of another one's result."""
    import torch

    class Giving(torch.nn.Module):
        def __init__(self):
            super().__init__()
            self.network = network

        def forward(self, pixel_values):
            return outputs(self.network(pixel_values))

    return Giving()


def export(module, example, path, outputs):
    """Write a torch module as ONNX with the input `pixel_values`."""
    import torch

    torch.onnx.export(
        module.eval(),
        (example,),
        str(path),
        dynamo=False,
        opset_version=18,
        input_names=["pixel_values"],
        output_names=outputs,
        verbose=False,
    )


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


def enliven(network) -> None:
    """Weights large enough that the random network's output follows its input."""
    import torch

    with torch.no_grad():
        for parameter in network.parameters():
            if parameter.dim() > 1:
                parameter.normal_(0, 1 / math.sqrt(parameter[0].numel()))


def picture_854() -> np.ndarray:
    """A smooth coloured picture of CholecSeg8k's size."""
    rows, columns = np.mgrid[:480, :854]
    waves = [np.sin(columns / 60), np.cos(rows / 45), np.sin((rows + columns) / 80)]
    return np.stack([127 + 100 * wave for wave in waves], axis=-1).astype(np.uint8)


def enlarged(values) -> np.ndarray:
    """Torch's bilinear resize to the picture's size."""
    import torch

    return torch.nn.functional.interpolate(values[:, None], size=(480, 854), mode="bilinear")[0, 0].numpy()


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore")
def test_depthpro_by_both_of_its_presets(tmp_path):
    torch = pytest.importorskip("torch")
    transformers = pytest.importorskip("transformers")
    torch.manual_seed(0)
    vit = {"model_type": "dinov2", "num_hidden_layers": 2, "hidden_size": 16, "num_attention_heads": 2}
    vit |= {"intermediate_size": 32, "image_size": 384, "patch_size": 16}
    network = transformers.DepthProForDepthEstimation(
        transformers.DepthProConfig(
            image_model_config=vit,
            patch_model_config=vit,
            fov_model_config=vit,
            fusion_hidden_size=8,
            intermediate_hook_ids=[1, 0],
            intermediate_feature_dims=[8, 8],
            scaled_images_feature_dims=[16, 16, 8],
            use_fov_model=True,
        )
    ).eval()
    enliven(network)
    with torch.no_grad():
        network.fov_model.head.layers[-1].bias.fill_(70.0)

    def outputs(result):
        """Canonical inverse depth with its field of view, and what the published files give instead."""
        focal = 0.5 * 1536 / torch.tan(math.radians(0.5) * result.field_of_view)
        metres = focal / (1536 * result.predicted_depth.clamp(1e-4, 1e4))
        return result.predicted_depth, result.field_of_view, metres, focal

    image = picture_854()
    preset = load_preset("depthpro-canonical")
    tensor = torch.from_numpy(preprocess(image, preset, place(480, 854, preset)))
    both, module = tmp_path / "both.onnx", giving(network, outputs)
    export(module, tensor, both, ["canonical", "fov", "metres", "focal"])
    rename_outputs(both, tmp_path / "a.onnx", {"canonical": "predicted_depth", "fov": "field_of_view"})
    rename_outputs(both, tmp_path / "b.onnx", {"metres": "predicted_depth", "focal": "focallength_px"})
    with torch.no_grad():
        canonical, fov, metres, _ = module(tensor)
    assert 0 < float(fov) < 180
    focal = 0.5 * 854 / math.tan(math.radians(float(fov)) / 2)
    source = Pictures([image])
    frame = next(iter(source))

    depth = open_depth(DepthSettings("depthpro-canonical", str(tmp_path / "a.onnx")), ClipLayout(), source)
    map_ = depth(frame)
    inverse = enlarged(canonical)
    usable = inverse > 0.01 * inverse.max()
    assert usable.mean() > 0.5
    assert 854 * depth.focal == pytest.approx(focal, rel=1e-4)
    assert focal / 854 / map_[usable] == pytest.approx(inverse[usable], abs=1e-4 * float(inverse.max()))

    depth = open_depth(DepthSettings("depthpro", str(tmp_path / "b.onnx")), ClipLayout(), source)
    map_ = depth(frame)
    assert depth.metric
    assert 854 * depth.focal == pytest.approx(focal, rel=1e-4)
    expected = enlarged(metres)
    # Near C = 0 metres magnify float noise, so the tolerance is wider than for C itself.
    assert map_ == pytest.approx(expected, rel=1e-2, abs=1e-4 * float(expected.max()))

    with pytest.raises(InputError, match=r"a.onnx has the outputs .*field_of_view, and not focallength_px"):
        open_depth(DepthSettings("depthpro", str(tmp_path / "a.onnx")), ClipLayout(), source)


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize("kind", ["relative", "metric"])
def test_depth_anything(tmp_path, kind):
    torch = pytest.importorskip("torch")
    transformers = pytest.importorskip("transformers")
    torch.manual_seed(0)
    backbone = transformers.Dinov2Config(
        num_hidden_layers=4,
        hidden_size=16,
        num_attention_heads=2,
        intermediate_size=32,
        image_size=518,
        patch_size=14,
        out_indices=[1, 2, 3, 4],
        apply_layernorm=True,
        reshape_hidden_states=False,
    )
    network = transformers.DepthAnythingForDepthEstimation(
        transformers.DepthAnythingConfig(
            backbone_config=backbone,
            reassemble_hidden_size=16,
            neck_hidden_sizes=[8, 8, 8, 8],
            fusion_hidden_size=8,
            head_hidden_size=8,
            depth_estimation_type=kind,
            max_depth=20 if kind == "metric" else 1,
        )
    ).eval()
    enliven(network)
    with torch.no_grad():
        network.head.conv3.bias.fill_(0.5)

    module = giving(network, lambda result: result.predicted_depth)
    name = "depth-anything-v2" if kind == "relative" else "depth-anything-v2-metric"
    preset = load_preset(name)
    image = picture_854()
    tensor = torch.from_numpy(preprocess(image, preset, place(480, 854, preset)))
    assert tensor.shape == (1, 3, 518, 924)
    export(module, tensor, tmp_path / "x.onnx", ["predicted_depth"])
    with torch.no_grad():
        expected = enlarged(module(tensor))
    source = Pictures([image])
    settings = DepthSettings(name, str(tmp_path / "x.onnx"), near=0.05, far=0.2)
    depth = open_depth(settings, ClipLayout(), source)
    result = depth(next(iter(source)))
    if kind == "relative":
        low, high = np.quantile(expected, [0.001, 0.999])
        share = np.maximum((expected - low) / (high - low), 0)
        expected = 1 / (5 + 15 * share)
    assert depth.metric == (kind == "metric")
    assert result == pytest.approx(expected, rel=2e-3)
