"""One ONNX graph that estimates presses by their light frame by frame: features, network, calibration and verdict.

What was seen of a press so far goes in and out as `state`, so that ONNX Runtime alone follows presses, in any language
that it has. Its numbers are those of `NetworkEstimator.lit`. `estimators.network.light_calibration` is the door.
"""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import onnx
import onnxruntime
import torch
from torch import Tensor, nn

from palpate.data.brightness.sequence import SIDE
from palpate.data.contact import light_features
from palpate.data.contact.features import SLOTS, slot_times
from palpate.data.contact.light_features import RINGS, SHAPES, LightSlots, light_amounts, light_shapes
from palpate.estimators.direct.brightness import LEAST_NOISE
from palpate.estimators.estimate import COMBINATIONS
from palpate.estimators.model_settings import section
from palpate.estimators.network.estimator import BOUND_MARGIN, LARGEST_LEFT, LEAST_OBSERVATIONS
from palpate.models.onnx_export import to_onnx, write
from palpate.models.onnx_session import LIGHT, LIGHT_COVARIANCE, LIGHT_MEAN, ModelFileError, PosteriorModel
from palpate.physics.identifiability import LIMIT, NOTHING, box_information
from palpate.physics.mechanics import Bounds

HEAD = "press"
"""Value of the metadata's `head` for such a file."""
STATE = SLOTS * (SHAPES + 1) + RINGS + 2
"""Length of a press's state: amounts of the shapes and what they leave at every slot, which rings the first frame
shows, the latest frame's time [s], and how many frames there were."""
INPUTS = ("change", "times", "scene", "reset", "state")
"""Of a frame of B presses, float64 unless another type is named: change of the logarithm of light since rest
[B, SIDE, SIDE], float32, not a number where no tissue is seen; time since the onset and time under load, infinite until
its end is seen [B, 2] [s]; distance, focal length, rim and coder's step as of `LightSlots`, and the sequence's noise
[B, 5]; whether the press begins [B], bool; `next_state` of the frame before [B, STATE]."""
OUTPUTS = ("next_state", "known", "left", "misfit", "log_mean", "log_covariance", "determined", "at_bound")
"""Of B presses so far: state; how many slots are known [B], int64; share of the change that the shapes leave, and
misfit [B]; mean [B, 3] and covariance [B, 3, 3] of (log k_s, log k_d, log |F|), not numbers before the second frame;
whether each of COMBINATIONS is determined [B, 6], and each of k_s, k_d and F at its bound [B, 3], bool."""
SWEEPS = 5
"""Of Jacobi's rotations; four leave nothing off the diagonal of a matrix [3, 3]."""


class _Press(nn.Module):
    """INPUTS, and what the network makes of the vector → OUTPUTS and that vector, as `LightSlots.vectors` gives it."""

    def __init__(self, bounds: Bounds) -> None:
        super().__init__()
        shapes, inner = light_shapes()
        self.places = torch.from_numpy(np.flatnonzero(inner))
        self.shapes, self.slots = torch.from_numpy(shapes), torch.from_numpy(slot_times())
        self.whole, self.box = self.shapes.square().sum(dim=0), torch.from_numpy(bounds.log_box)
        self.prior = torch.from_numpy(box_information(bounds.log_box))
        self.powers = _double(list(COMBINATIONS.values()))

    def forward(
        self, change: Tensor, times: Tensor, scene: Tensor, reset: Tensor, state: Tensor, mean: Tensor, spread: Tensor
    ) -> tuple[Tensor, ...]:
        time, load = times.split(1, dim=1)
        state = torch.where(reset[:, None], 0.0, state)
        rows, first, before, frames = state.split([SLOTS * (SHAPES + 1), RINGS, 1, 1], dim=1)
        amounts, left, visible = self._amounts(change)
        begun, rows, now = frames > 0, rows.reshape(-1, SLOTS, SHAPES + 1), torch.cat([amounts, left], dim=1)
        first = torch.where(begun, first, visible)
        # Slots that lie ahead hold the latest frame's; before the first one amounts are 0, and what is left is its own.
        last = torch.cat([rows[:, -1, :SHAPES], torch.where(begun, rows[:, -1, SHAPES:], left)], dim=1)
        share = ((self.slots - before) / (time - before).clamp(min=1e-9)).clamp(0, 1)
        along = last[:, None] + share[..., None] * (now - last)[:, None]
        rows = torch.where((self.slots > before)[..., None], along, rows)
        following = torch.cat([rows.flatten(1), first, time, frames + 1], dim=1)

        known = (self.slots <= time + 1e-9).sum(dim=1).clamp(min=1)
        counts = (torch.arange(SLOTS) < known[:, None]).double()
        amounts, left = (rows * counts[..., None]).split([SHAPES, 1], dim=2)
        latest = self.slots[known - 1][:, None]
        squares = left.square().sum(dim=(1, 2))
        explained = (amounts @ self.shapes.T).square().mean(dim=2).sum(dim=1)
        unexplained = torch.sqrt(squares / (squares + explained).clamp(min=1e-12))
        distance, focal, rim, step, noise = scene.split(1, dim=1)
        misfit = torch.sqrt(squares / known) / torch.maximum(noise[:, 0], _double(LEAST_NOISE))
        small, far = (amounts / _double(light_features.SMALL)).abs(), light_features.FARTHEST_RIM
        vector = (
            torch.sign(amounts) * torch.log(small + torch.sqrt(small.square() + 1)) / 3,  # not every runtime has asinh
            amounts / _double(light_features.LARGE),
            20 * left,
            counts,
            (self.slots <= load + 1e-9) * counts,
            first,
            torch.where(latest > load + 1e-9, visible, first),
            torch.log(distance / _double(light_features.USUAL_DISTANCE)),
            torch.log(light_features.USUAL_FOCAL / focal),
            rim.clamp(max=far) / far,
            torch.minimum(load, latest),
            torch.log(1 + step / _double(light_features.USUAL_STEP)),
        )
        light = torch.cat([part.flatten(1) for part in vector], dim=1).float()

        mean, covariance, seen = mean.double(), spread.double(), frames + 1 >= LEAST_OBSERVATIONS
        values, vectors = _eigen(_solved(covariance, torch.eye(3).double().expand_as(covariance)) - self.prior)
        limits = torch.sqrt((self.powers @ vectors).square() @ (1 / values.clamp(min=NOTHING))[..., None])[..., 0]
        determined = (limits < LIMIT) & (unexplained <= _double(LARGEST_LEFT))[:, None] & seen
        margin = torch.minimum(mean - self.box[0], self.box[1] - mean)
        at_bound = (margin < _double(BOUND_MARGIN) * (self.box[1] - self.box[0])) & seen
        mean, covariance = torch.where(seen, mean, torch.nan), torch.where(seen[..., None], covariance, torch.nan)
        return following, known, unexplained, misfit, mean, covariance, determined, at_bound, light

    def _amounts(self, change: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """As of `light_amounts`: amounts [B, SHAPES], what they leave [B, 1], and the visible of RINGS [B, RINGS]."""
        values = change.flatten(1)[:, self.places].double()
        visible = values.abs() < torch.inf
        values = torch.where(visible, values, 0.0).clamp(light_features.LEAST, light_features.MOST)
        some = self.shapes * visible[..., None]
        square = some.transpose(1, 2) @ some + torch.diag(_double(light_features.RIDGE) * self.whole)
        amounts = _solved(square, some.transpose(1, 2) @ values[..., None])[..., 0]
        left = torch.where(visible, values - amounts @ self.shapes.T, 0.0)
        rms = torch.sqrt(left.square().sum(dim=1) / visible.sum(dim=1).clamp(min=1))
        return amounts, rms[:, None], (some.square().sum(dim=1) / self.whole)[:, :RINGS]


def _double(numbers: float | Sequence[Sequence[float]]) -> Tensor:
    """Numbers as a tensor, which the exporter keeps as it is; others it rounds to single precision."""
    return torch.tensor(numbers, dtype=torch.float64)


def _solved(matrix: Tensor, right: Tensor) -> Tensor:
    """Solutions [B, N, K] of symmetric positive systems [B, N, N], by eliminations: ONNX has no operator for it."""
    both, unit = torch.cat([matrix, right], dim=2), torch.eye(matrix.shape[-1]).double()
    for at in range(len(unit)):
        row = both[:, at : at + 1]
        both = both - (both[..., at : at + 1] - unit[:, at : at + 1]) * (row / row[..., at : at + 1])
    return both[..., len(unit) :]


def _eigen(matrix: Tensor) -> tuple[Tensor, Tensor]:
    """Eigenvalues [B, 3] and eigenvectors as columns [B, 3, 3] of symmetric matrices, by Jacobi's rotations."""
    unit = torch.eye(3).double()
    vectors = unit.expand_as(matrix)
    spins = [(one, other, unit[one].outer(unit[other])) for one, other in ((0, 1), (0, 2), (1, 2))]
    spins = [(one, other, half - half.T, half @ half.T + half.T @ half) for one, other, half in spins]
    for one, other, spin, plane in spins * SWEEPS:
        gap, twice = matrix[:, other, other] - matrix[:, one, one], 2 * matrix[:, one, other]
        length = gap.abs() + torch.sqrt(gap.square() + twice.square())
        tangent = (torch.where(gap < 0, -twice, twice) / length.clamp(min=1e-300))[:, None, None]
        cosine = 1 / torch.sqrt(1 + tangent.square())
        turn = unit + cosine * tangent * spin + (cosine - 1) * plane
        matrix, vectors = turn.transpose(1, 2) @ matrix @ turn, vectors @ turn
    return matrix.diagonal(dim1=1, dim2=2), vectors


def write_causal(source: Path, output: Path) -> float:
    """Write the file.

    Args:
        source: exported posterior with one by light, as it is calibrated.
        output: file to write; it appears only when it agrees with `LightSlots` and the network on a random press.

    Returns:
        Largest difference of mean and covariance from theirs.

    Raises:
        ModelFileError: the source is no exported posterior, or knows nothing of light.
        ForeignFile: another file than an exported network is at `output`.
        ParityError: the difference is over 1e-5.
    """
    network = PosteriorModel(source)
    if not network.sees_light:
        remedy = "give a file to which estimators.network.light_calibration added it"
        raise ModelFileError(f"{source} knows nothing of light; {remedy}.")
    inputs = dict(zip(INPUTS, map(torch.from_numpy, _random(2)), strict=True))
    inputs |= {LIGHT_MEAN: torch.zeros(2, 3), LIGHT_COVARIANCE: torch.eye(3).expand(2, 3, 3)}
    model = to_onnx(_Press(section(network, "bounds", Bounds)).eval(), inputs, (*OUTPUTS, LIGHT))
    added = onnx.utils.Extractor(onnx.load(source)).extract_model([LIGHT], [LIGHT_MEAN, LIGHT_COVARIANCE]).graph
    graph, nodes = model.graph, list(model.graph.node)
    at = 1 + next(index for index, node in enumerate(nodes) if LIGHT in node.output)
    del graph.node[at:], graph.input[len(INPUTS) :], graph.output[len(OUTPUTS) :]
    graph.node.extend([*added.node, *nodes[at:]])
    graph.initializer.extend(added.initializer)
    document = network.metadata | {"head": HEAD, "determined": list(COMBINATIONS)}
    return write(model, document, output, lambda path: _difference(path, network))


def _random(frames: int) -> tuple[np.ndarray, ...]:
    """INPUTS of a press that is released in view, in so many frames."""
    random = np.random.default_rng(0)
    change = random.normal(-0.1, 0.1, (frames, SIDE, SIDE)).astype(np.float32)
    change[random.random(change.shape) < 0.2] = np.nan
    times, scene = np.full((frames, 2), 0.4), np.tile([0.35, 160.0, 20.0, 0.01, 0.02], (frames, 1))
    times[:, 0] = slot_times()[:frames]
    return change, times, scene, np.arange(frames) == 0, np.zeros((frames, STATE))


def _difference(path: Path, network: PosteriorModel) -> float:
    """Largest of mean and covariance of that press from those of its `LightSlots`, at its end."""
    session, frames = onnxruntime.InferenceSession(path), _random(SLOTS)
    found = light_amounts(frames[0])
    numbers = found.amounts, found.left, found.visible[[0, -1]], frames[1][0, 1], *frames[2][0, :4]
    slots = LightSlots(*(np.asarray(values)[None] for values in numbers))
    results = [np.zeros((1, STATE))]
    for values in zip(*frames[:-1], strict=True):
        given = *(value[None] for value in values), results[0]
        results = session.run(OUTPUTS, dict(zip(INPUTS, given, strict=True)))
    expected = network.by_light(slots.vectors(np.array([SLOTS])))
    return max(float(np.abs(one - other).max()) for one, other in zip(results[4:6], expected, strict=True))
