"""Records of every pair of frames by `train.py test`, for the tables and figures of `results.paper`."""

import math
from typing import Any

import numpy as np
import torch
from torch import Tensor

from palpate.models.generator import Generator
from palpate.models.losses import masked_l1
from palpate.models.step import Pass
from palpate.physics.mechanics import REFERENCE_DAMPING, REFERENCE_STIFFNESS, Mechanics
from palpate.physics.msd import rollout
from palpate.physics.msd.batch import PairBatch
from palpate.physics.msd.likelihoods import displacement_error
from palpate.physics.observation import Observation


def with_reference_tissue(theta: Tensor) -> Tensor:
    """θ [B, 3] with k_s and k_d replaced by the literature's, F as it is (Bini 2026, section 4.1)."""
    tissue = theta.new_tensor([REFERENCE_STIFFNESS, REFERENCE_DAMPING]).expand(len(theta), 2)
    return torch.cat([tissue, theta[:, 2:]], dim=1)


def farthest_corner(theta: Tensor, lower: Tensor, upper: Tensor) -> Tensor:
    """The corner of the box farthest from θ [B, 3], parameter by parameter: the strongest change of condition."""
    return torch.where(theta - lower > upper - theta, lower, upper)


@torch.no_grad()
def pair_records(batch: PairBatch, generator: Generator, mechanics: Mechanics) -> list[dict[str, Any]]:
    """One record for each pair of the batch, forward in time.

    Args:
        batch: a batch of the data module.
        generator: G_AB.
        mechanics: the rollout's constants.

    Returns:
        Dictionaries with:
        `clip` (name), `frame` (index of t), `theta` [3] (physical units);
        `trajectory`, `reference_trajectory` [T, 3]: contact vertex under θ, and under the literature's k_s and k_d with
        the same F [scene units];
        `mesh`, `load`, `observation`: the simulation's input, and the observed motion;
        `error_predicted`, `error_reference`: squared displacement errors [scene units²];
        `next_depth_error`, `copy_error`: mean |Δz| of G_AB's picture, and of D_t itself, against D_t+1, over pixels
        valid in both;
        `theta_sensitivity`: mean |Δz| of the picture when θ moves to the box's farthest corner.
    """
    one = Pass(generator, batch.a, mechanics)
    meshes, loads, observation = batch.a.meshes, batch.a.loads, batch.a.observation
    now, later, theta = one.real, batch.b.window[:, -1:], one.answer.theta
    corner = farthest_corner(theta, generator.head.lower, generator.head.upper)
    predicted, moved = one.fake, one.next_map(corner, one.change_under(corner))
    trajectory = rollout(theta.cpu(), meshes, loads, mechanics)
    reference = rollout(with_reference_tissue(theta.cpu()), meshes, loads, mechanics)
    error, reference_error = (displacement_error(simulated, observation) for simulated in (trajectory, reference))
    records = []
    for index, (clip, sheet, press) in enumerate(zip(batch.clips, meshes, loads, strict=True)):
        target = later[index] * (now[index] > 0)
        kept = observation.weight[index] > 0
        times = (_numpy(observation.steps[index][kept]) + 1) * mechanics.time_step
        observed = _numpy(observation.displacement[index][kept])
        known = Observation.of_point(press.vertex, times, observed, math.nan)
        found: dict[str, Any] = {"clip": clip, "frame": int(batch.frames[index])}
        found |= {"mesh": sheet, "load": press, "observation": known}
        arrays = {"theta": theta, "trajectory": trajectory, "reference_trajectory": reference}
        found |= {name: _numpy(values[index]) for name, values in arrays.items()}
        errors = {"error_predicted": error[index], "error_reference": reference_error[index]}
        errors |= {"next_depth_error": masked_l1(predicted[index], target), "copy_error": masked_l1(now[index], target)}
        errors["theta_sensitivity"] = masked_l1(moved[index], predicted[index])
        records.append(found | {name: float(value) for name, value in errors.items()})
    return records


def _numpy(tensor: Tensor) -> np.ndarray:
    return tensor.detach().cpu().numpy()
