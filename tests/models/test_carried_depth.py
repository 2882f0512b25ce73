"""Depth maps carried along by the rollout: against the synthetic renderer, by hand, and their gradient."""

import dataclasses

import numpy as np
import pytest
import torch

from benchmarks.recovery.trial import observed_contacts
from palpate.data.synthetic.clip import draw_truth, synthetic_clip
from palpate.data.synthetic.settings import SceneSettings
from palpate.data.synthetic.source import PREPARE, open_synthetic
from palpate.estimators.contract import ClipInfo
from palpate.models.carried_depth import change, shifted
from palpate.models.generator import Generator
from palpate.models.step import Pass
from palpate.physics.load import Press
from palpate.physics.mechanics import Mechanics
from palpate.physics.mesh import Mesh
from palpate.physics.msd import rollout

MECHANICS = Mechanics(steps=24, load_steps=8)
SECOND = Mechanics(scheme="dkd")
KINDS = "direct", "physics"
THETA = torch.tensor([[0.4, 0.05, -0.05], [0.3, 0.08, -0.08]])


def parts(batch) -> tuple[list[Mesh], list[Press]]:
    return batch.a.meshes, batch.a.loads


def carried(depth: torch.Tensor, theta: torch.Tensor, *rest) -> torch.Tensor:
    return shifted(depth, change(theta, *rest))


def course(*steps: int) -> torch.Tensor:
    return torch.tensor([steps, steps])


def test_nothing_moves_without_a_force_or_without_time(make_batch) -> None:
    batch = make_batch()
    depth = batch.a.window[:, -1:]
    still = carried(depth, THETA * torch.tensor([1.0, 1.0, 0.0]), *parts(batch), course(0, 8), MECHANICS)
    torch.testing.assert_close(still, depth)
    same = carried(depth, THETA, *parts(batch), course(5, 5), MECHANICS)
    torch.testing.assert_close(same, depth)


def test_there_and_back_is_where_it_was(make_batch) -> None:
    batch = make_batch()
    depth = batch.a.window[:, -1:]
    there = carried(depth, THETA, *parts(batch), course(2, 8), MECHANICS)
    assert (there - depth).abs().max() > 0.002
    torch.testing.assert_close(carried(there, THETA, *parts(batch), course(8, 2), MECHANICS), depth, atol=1e-6, rtol=0)
    assert (there[depth == 0] == 0).all()


def test_steps_beyond_the_rollout_are_its_last_one(make_batch) -> None:
    batch = make_batch()
    depth = batch.a.window[:, -1:]
    last, beyond = (carried(depth, THETA, *parts(batch), course(0, end), MECHANICS) for end in (24, 90))
    torch.testing.assert_close(last, beyond)


def test_a_motion_along_the_line_of_sight_is_the_change_of_the_depth(make_batch) -> None:
    """Change at the pressed vertex, which lies on the optical axis: hardly anything shifts it sideways in its pixel."""
    batch = make_batch()
    depth, (mesh, load) = batch.a.window[:, -1:], parts(batch)
    load = [dataclasses.replace(press, direction=np.array([0.0, 0.0, -1.0])) for press in load]
    moved = rollout(THETA, mesh, load, MECHANICS)[:, 7]
    after = carried(depth, THETA, mesh, load, course(0, 8), MECHANICS)
    rows, columns = np.transpose([sheet.pixels[press.vertex] for sheet, press in zip(mesh, load, strict=True)])
    seen = (after - depth)[torch.arange(2), 0, rows, columns]
    assert (seen > 0.004).all()
    torch.testing.assert_close(seen, moved[:, 2], rtol=0.08, atol=0)


def test_gradient_by_theta_is_that_of_differences(make_batch) -> None:
    batch = make_batch()
    depth, theta = batch.a.window[:, -1:].double(), THETA.double().requires_grad_()
    weights = torch.from_numpy(np.random.default_rng(0).normal(size=depth.shape))

    def value(theta: torch.Tensor) -> torch.Tensor:
        return (weights * carried(depth, theta, *parts(batch), course(3, 8), MECHANICS)).sum()

    value(theta).backward()
    for index in range(3):
        step = torch.zeros_like(theta)
        step[:, index] = 1e-6
        with torch.no_grad():
            difference = (value(theta + step) - value(theta - step)) / 2e-6
        assert float(theta.grad[:, index].sum()) == pytest.approx(float(difference), rel=1e-5)


@pytest.mark.parametrize("seed", [3, 4])
def test_the_true_theta_makes_the_renderers_next_picture(seed: int) -> None:
    """Four frames on, noise-free: what is left of the change where it is largest is at most a quarter."""
    settings = SceneSettings(width=214, height=120, regime="under-damped", frames=32)
    scene, motion = draw_truth(settings, seed)
    stream = open_synthetic(synthetic_clip(scene, motion, seed), PREPARE)
    frames = list(stream)
    contact = observed_contacts(frames, ClipInfo.of(stream))[motion.onset_frame]
    sheet = [contact.mesh], [contact.load]
    theta = torch.tensor(motion.theta[None], dtype=torch.float32)
    row, column = contact.mesh.pixels[contact.vertex]
    near = np.s_[row - 7 : row + 8, column - 7 : column + 8]
    copied, left = [], []
    for since in (1, 3, 5):
        now, later = (frames[motion.onset_frame + since + further] for further in (0, 4))
        steps = torch.tensor([[round(frame * 0.04 / SECOND.time_step) for frame in (since, since + 4)]])
        made = carried(torch.from_numpy(now.depth)[None, None], theta, *sheet, steps, SECOND)[0, 0].numpy()
        seen = (now.labels == later.labels)[near] & (now.depth > 0)[near]
        copied.append((now.depth - later.depth)[near][seen])
        left.append((made - later.depth)[near][seen])
    copied, left = np.concatenate(copied), np.concatenate(left)
    moving = np.abs(copied) > 0.004
    assert moving.sum() > 10
    assert np.abs(left[moving]).mean() < 0.25 * np.abs(copied[moving]).mean()


def test_only_decoder_physics_starts_from_a_carried_map(make_batch) -> None:
    batch = make_batch()
    batch.a.course = course(2, 8)
    direct, physics = (Pass(Generator(width=4, residual_blocks=1, decoder=kind), batch.a, MECHANICS) for kind in KINDS)
    assert direct.change_under(THETA) is None
    assert shifted(direct.real, None) is direct.real
    onward = shifted(physics.real, physics.change_under(THETA))
    torch.testing.assert_close(onward, carried(physics.real, THETA, *parts(batch), course(2, 8), MECHANICS))
