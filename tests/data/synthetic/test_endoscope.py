"""The second renderer: its labels and depth are those of the scene, its light answers to tilt, distance and shadow."""

import numpy as np
import pytest

from palpate.data.synthetic.clip import draw_truth
from palpate.data.synthetic.endoscope import TARGET, EndoscopeRenderer
from palpate.data.synthetic.render import GREY, Renderer
from palpate.data.synthetic.settings import SceneSettings

SIZE = {"width": 428, "height": 240, "frames": 20}


def renderers(seed: int, **settings):
    scene, truth = draw_truth(SceneSettings(**SIZE, look="endoscope", **settings), seed)
    return scene, truth, EndoscopeRenderer(scene, truth, np.random.default_rng(seed))


def test_depth_and_labels_are_those_of_the_other_renderer():
    """But for the rounding between vertices, where a dent is steep."""
    scene, truth, renderer = renderers(3)
    other = Renderer(scene, truth, np.random.default_rng(3))
    for index in (0, truth.onset_frame + 3):
        _, labels, depth = renderer.frame(index)
        _, expected_labels, expected_depth = other.frame(index)
        assert (labels == expected_labels).mean() > 0.995
        tissue = (labels != GREY["grasper"]) & (expected_labels != GREY["grasper"])
        off = np.abs(depth - expected_depth)[tissue]
        assert np.median(off) < 1e-4
        assert off.max() < 0.6 * truth.peak


def test_the_tissue_under_a_press_sinks_as_far_as_its_vertex():
    scene, truth, renderer = renderers(3, tool_in_view=False)
    index = truth.onset_frame + 3
    _, _, depth = renderer.frame(index)
    vertex = scene.mesh.vertices[scene.vertex] + truth.contact[index]
    column, row = vertex[:2] / vertex[2] * [scene.camera.fx, scene.camera.fy] + [scene.camera.cx, scene.camera.cy]
    # Pixels lie a quarter of a grid pixel off the vertex, in a dent that is three wide.
    assert depth[round(row), round(column)] == pytest.approx(vertex[2], abs=0.2 * truth.peak)


def test_a_dent_darkens_its_walls_and_exposure_follows_the_picture():
    scene, truth, renderer = renderers(3, tool_in_view=False, image_noise=0.0)
    rest = renderer.frame(0)[0].astype(float)
    assert np.square(rest / 255).mean() == pytest.approx(TARGET, rel=0.5)
    pressed = renderer.frame(truth.onset_frame + 3)[0].astype(float)
    column, row = (scene.mesh.pixels[scene.vertex][::-1] * 2).tolist()
    around = np.s_[row - 8 : row + 9, column - 8 : column + 9]
    assert pressed[around].min() < rest[around].min() - 5
    far = np.s_[:40, :40]
    assert np.abs(pressed[far] - rest[far]).mean() < 2.5


def test_an_instrument_throws_shadows_beyond_itself():
    _, truth, with_tool = renderers(3, image_noise=0.0)
    _, _, without = renderers(3, image_noise=0.0, tool_in_view=False)
    index = truth.onset_frame - 1
    with_tool.frame(0), without.frame(0)
    shown, labels, _ = with_tool.frame(index)
    bare = without.frame(index)[0].astype(float)
    ratio = (shown.astype(float).sum(axis=-1) / bare.sum(axis=-1))[labels != GREY["grasper"]]
    assert np.quantile(ratio, 0.001) < 0.9 * np.median(ratio)
