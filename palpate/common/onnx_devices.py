"""Devices of ONNX networks, by ONNX Runtime's names, and the one place that opens a network."""

import os
import re

import onnxruntime

PROVIDERS = {"cuda": "CUDAExecutionProvider", "openvino": "OpenVINOExecutionProvider", "cpu": "CPUExecutionProvider"}
"""Names of ONNX Runtime for each device, the best first."""
AUTO = "auto"
DEVICES = (AUTO, *reversed(PROVIDERS))
"""Devices that `open_session` takes."""


class DeviceError(ValueError):
    """A device that can't be used here, in one sentence with the remedy."""


def open_session(model: str | bytes, threads: int, device: str) -> onnxruntime.InferenceSession:
    """Open a network.

    Args:
        model: path or content of an ONNX file.
        threads: CPU threads for one call; 0 leaves the choice to ONNX Runtime.
        device: one of `DEVICES`; auto is the best that the installed ONNX Runtime offers, and the CPU where that fails.

    Raises:
        DeviceError: there is no such device, or the installed ONNX Runtime lacks it or
            can't use it.
        Exception: the network can't be opened; ONNX Runtime's own exceptions have no common class.
    """
    if device not in DEVICES:
        raise DeviceError(f"there is no device {device}; choose {', '.join(DEVICES)}.")
    installed = onnxruntime.get_available_providers()
    provider = PROVIDERS[device] if device != AUTO else next(name for name in PROVIDERS.values() if name in installed)
    package = {"cuda": "onnxruntime-gpu", "openvino": "onnxruntime-openvino"}.get(device, "onnxruntime")
    if provider not in installed:
        raise DeviceError(f"device {device} is not in this onnxruntime; install {package}, or choose auto.")
    options = onnxruntime.SessionOptions()
    options.log_severity_level = 4  # errors are reported once, by whoever opens the network
    # More threads than cores would wait for each other, busily.
    options.intra_op_num_threads = min(threads, os.cpu_count() or 1)
    # Threads that wait must not keep cores from other stages.
    options.add_session_config_entry("session.intra_op.allow_spinning", "0")
    options.use_deterministic_compute = True
    session = onnxruntime.InferenceSession(model, options, providers=[provider], enable_fallback=device == AUTO)
    if device != AUTO and provider_of(session) != provider:
        raise DeviceError(f"device {device} fails here; install what {package} needs, or choose auto.")
    return session


def opening_problem(error: Exception) -> str:
    """Return the reason why a network can't be opened, and what to do, for a sentence that begins with its file."""
    if re.search(r"\bopset\b|\bIR version|model file format version", str(error), re.IGNORECASE):
        known = f"than onnxruntime {onnxruntime.__version__} reads"
        return f"has a newer opset or IR version {known}; export it with a lower opset_version, or update onnxruntime"
    return f"can't be opened as an ONNX model ({first_line(error)}); export or download it again"


def first_line(error: Exception) -> str:
    """Return the first line of an error, short enough for a sentence, without ONNX Runtime's code and path at its
    beginning."""
    line = (str(error).strip() or type(error).__name__).split("\n")[0]
    return re.sub(r"^\[ONNXRuntimeError\] : \d+ : \w+ : (Load model from .* failed:)?", "", line)[:200].rstrip(". ")


def provider_of(session: onnxruntime.InferenceSession) -> str:
    """Return the provider that really runs a network, one of `PROVIDERS`' names; what it can't do is left to the
    CPU."""
    return session.get_providers()[0]
