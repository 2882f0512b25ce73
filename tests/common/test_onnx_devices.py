"""Which of ONNX Runtime's providers a network is opened with, and what is said where it isn't the one asked for."""

import re
from types import SimpleNamespace

import onnxruntime
import pytest

from palpate.common.onnx_devices import DeviceError, open_session, opening_problem, provider_of

CUDA, OPENVINO, CPU = "CUDAExecutionProvider", "OpenVINOExecutionProvider", "CPUExecutionProvider"


@pytest.mark.parametrize(
    ("error", "said"),
    [
        ("Fail: Opset 99 is under development", "has a newer opset or IR version than onnxruntime"),
        ("Unsupported model IR version: 99, max supported IR version: 13", "export it with a lower opset_version"),
        ("[ONNXRuntimeError] : 7 : INVALID_PROTOBUF : Load model from x failed:No.", r"ONNX model \(No\); export or"),
    ],
)
def test_what_can_not_be_opened_gets_the_remedy_that_helps(error: str, said: str) -> None:
    assert re.search(said, opening_problem(RuntimeError(error)))


def offer(monkeypatch: pytest.MonkeyPatch, *offered: str, works: bool = True) -> list[bool]:
    """Make ONNX Runtime offer these; returns whether it was allowed to try others, call by call."""
    allowed: list[bool] = []

    def opened(model: str, options: object, *, providers: list[str], enable_fallback: bool) -> SimpleNamespace:
        allowed.append(enable_fallback)
        return SimpleNamespace(get_providers=lambda: [*(providers if works else []), CPU])

    monkeypatch.setattr(onnxruntime, "get_available_providers", lambda: ["AzureExecutionProvider", *offered])
    monkeypatch.setattr(onnxruntime, "InferenceSession", opened)
    return allowed


@pytest.mark.parametrize(
    ("offered", "device", "provider"),
    [
        ((CPU,), "auto", CPU),
        ((OPENVINO, CPU), "auto", OPENVINO),
        ((OPENVINO, CUDA, CPU), "auto", CUDA),
        ((OPENVINO, CUDA, CPU), "openvino", OPENVINO),
        ((OPENVINO, CUDA, CPU), "cpu", CPU),
    ],
)
def test_the_best_that_is_offered_or_the_one_asked_for(monkeypatch, offered, device, provider):
    allowed = offer(monkeypatch, *offered)
    assert provider_of(open_session("m.onnx", 1, device)) == provider
    assert allowed == [device == "auto"]


@pytest.mark.parametrize(("device", "package"), [("cuda", "onnxruntime-gpu"), ("openvino", "onnxruntime-openvino")])
def test_a_device_that_is_missing_or_fails_is_refused_with_what_to_install(monkeypatch, device, package):
    offer(monkeypatch, CPU)
    with pytest.raises(DeviceError, match=rf"^device {device} is not in this onnxruntime; install {package}, or"):
        open_session("m.onnx", 1, device)
    offer(monkeypatch, CUDA, OPENVINO, CPU, works=False)
    with pytest.raises(DeviceError, match=rf"^device {device} fails here; install what {package} needs"):
        open_session("m.onnx", 1, device)
    assert provider_of(open_session("m.onnx", 1, "auto")) == CPU  # which is what the record then says
    with pytest.raises(DeviceError, match="there is no device gpu; choose auto, cpu, openvino, cuda"):
        open_session("m.onnx", 1, "gpu")
