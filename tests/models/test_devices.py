"""Networks on one device, meshes on another: without a GPU, by tensors that refuse to be mixed with others."""

import copy
from collections.abc import Iterator
from contextlib import contextmanager, nullcontext
from typing import TypeVar

import pytest
import torch
from torch import Tensor, nn
from torch.overrides import TorchFunctionMode
from torch.utils._python_dispatch import TorchDispatchMode
from torch.utils._pytree import tree_leaves, tree_map_only

from palpate.models import step
from palpate.models.checkpoint import load_posterior
from palpate.models.losses import total
from palpate.models.module import PhysicsInformedGAN
from palpate.models.posterior import ContactPosterior
from palpate.physics.msd.batch import PairBatch
from tests.models.test_module import POSTERIOR, build

Module = TypeVar("Module", bound=nn.Module)
ELSEWHERE = torch.device("meta")


class Elsewhere(Tensor):
    """A tensor that says it is on another device than the CPU."""

    values: Tensor

    @staticmethod
    def __new__(cls, values: Tensor) -> "Elsewhere":
        found = Tensor._make_wrapper_subclass(
            cls, values.shape, values.stride(), dtype=values.dtype, device=ELSEWHERE, requires_grad=False
        )
        found.values = values
        return found

    @classmethod
    def __torch_dispatch__(cls, function, types, args=(), kwargs=None):
        return _computed(function, args, kwargs or {})


class Operations(TorchDispatchMode):
    """Mode in which what is made for the other device, or moved there, is `Elsewhere`."""

    def __torch_dispatch__(self, function, types, args=(), kwargs=None):
        return _computed(function, args, kwargs or {})


class Constants(TorchFunctionMode):
    """Mode that does so for `new_tensor`, which no dispatch mode sees."""

    def __torch_function__(self, function, types, args=(), kwargs=None):
        if function is Tensor.new_tensor:
            like, values = args
            return torch.tensor(values, dtype=(kwargs or {}).get("dtype", like.dtype)).to(like.device)
        return function(*args, **(kwargs or {}))


@contextmanager
def two_devices() -> Iterator[None]:
    """While it lasts, there is another device."""
    with Operations(), Constants():
        yield


def _computed(function, args, kwargs):
    """Compute as on the CPU, if all of the tensors are on one device; copies may cross, and so may single numbers."""
    tensors = [value for value in tree_leaves((args, kwargs)) if isinstance(value, Tensor)]
    elsewhere = any(isinstance(value, Elsewhere) for value in tensors)
    copies = function in (torch.ops.aten._to_copy.default, torch.ops.aten.copy_.default)
    here = [value for value in tensors if not isinstance(value, Elsewhere) and value.ndim]
    if elsewhere and here and not copies:
        raise AssertionError(f"{function} mixes devices")
    device = kwargs.get("device")
    if device is not None:
        elsewhere, kwargs = torch.device(device) == ELSEWHERE, kwargs | {"device": torch.device("cpu")}
    args, kwargs = tree_map_only(Elsewhere, lambda value: value.values, (args, kwargs))
    found = function(*args, **kwargs)
    if function is torch.ops.aten.copy_.default:
        return tensors[0]
    return tree_map_only(Tensor, Elsewhere, found) if elsewhere else found


def _moved(module: Module) -> Module:
    """Module moved to the other device."""
    moved = copy.deepcopy(module)
    for part in moved.modules():
        for name, values in part._parameters.items():
            if values is not None:
                part._parameters[name] = nn.Parameter(Elsewhere(values.detach()))
        for name, values in part._buffers.items():
            part._buffers[name] = None if values is None else Elsewhere(values)
    return moved


@pytest.mark.filterwarnings("ignore:.*copying from a non-meta parameter")
def test_a_pretrained_head_is_loaded_where_it_is(tmp_path):
    posterior, other = (ContactPosterior(6, torch.tensor(POSTERIOR["bounds"].log_box)) for _ in range(2))
    torch.save(other.state_dict(), tmp_path / "posterior.pt")
    with two_devices():
        moved = _moved(posterior)
        load_posterior(moved, tmp_path / "posterior.pt")
    for name, values in other.state_dict().items():
        assert torch.equal(moved.state_dict()[name].values, values)


def _losses(module: PhysicsInformedGAN, batch: PairBatch) -> dict[str, Tensor]:
    """All terms, and the gradient of each parameter of the first generator."""
    terms, found = module.generator_losses(batch)
    total(terms, module.weights).backward()
    gradients = {name: values.grad for name, values in module.generator_ab.named_parameters()}
    return (
        terms
        | {"theta": found.ab.answer.theta}
        | {name: values for name, values in gradients.items() if values is not None}
    )


@pytest.mark.parametrize(
    "settings",
    [
        {},
        {"decoder": "physics", "noise": 0.01},
        POSTERIOR | {"decoder": "physics"},
    ],
)
def test_meshes_stay_on_the_cpu_while_networks_are_elsewhere(make_batch, make_told_batch, settings, monkeypatch):
    monkeypatch.setattr(step, "precise", lambda _: nullcontext())  # this device has no mixed precision
    batch = make_told_batch() if "head" in settings else make_batch()
    module = build(**settings)
    for generator in (module.generator_ab, module.generator_ba):  # no map is left as it is: |0| has no slope
        nn.init.normal_(generator.decoder.output.weight, std=0.1)
    wanted = _losses(copy.deepcopy(module), batch)
    with two_devices():
        moved = _moved(module)
        found = _losses(moved, batch.to(ELSEWHERE))
    assert found.keys() == wanted.keys()
    assert all(isinstance(values, Elsewhere) for values in found.values())
    for name, values in wanted.items():
        torch.testing.assert_close(found[name].values, values, rtol=5e-3, atol=1e-4, msg=f"{name} differs")


def test_such_tensors_refuse_to_be_mixed():
    with two_devices():
        elsewhere = torch.ones(2).to(ELSEWHERE)
        with pytest.raises(AssertionError, match="mixes devices"):
            elsewhere + torch.ones(2)
        assert (elsewhere + 1.0).sum().item() == 4.0
