"""Exported networks at inference: ONNX in, numpy out. No torch.

There are two kinds: `ParameterModel` (depth windows → θ) and `PosteriorModel` (a contact's vector → mean and covariance
of log θ).
"""

import hashlib
import json
import reprlib
from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any, Literal

import numpy as np
import onnxruntime

from palpate.common.files import as_json, read_file
from palpate.common.onnx_devices import AUTO, DeviceError, open_session, opening_problem, provider_of
from palpate.common.settings import fits, sound
from palpate.models.calibration import Widths

SHIPPED = Path(__file__).resolve().parent / "weights" / "contact.onnx"
"""The contact posterior that ships with the program; its model card lies in the same folder."""
METADATA_KEY = "palpate"
"""Key of the custom metadata entry that holds everything inference needs, as one JSON document."""
FORMAT_VERSION = 1
"""Version of that document's layout; raised if readers of the old layout would misread the new one."""
POSTERIOR = "posterior"
"""Value of the document's `head` for a `PosteriorModel`."""
INPUT = "depth"
CONTACT, LOG_MEAN, LOG_COVARIANCE = "contact", "log_mean", "log_covariance"
EXPECTED_BOUND = "decisive_covariance"
"""Name in files of the covariance of `models.posterior.ExpectedBound`, by which verdicts are given."""

_FIELDS: dict[str, Any] = {
    "input": dict.fromkeys(("window", "height", "width"), range(1, 4097)),
    **dict.fromkeys(("bounds", "mechanics", "geometry", "classes"), dict),
    "depth": {"source": str},
    **dict.fromkeys(("head", "observation", "masks"), str),
    **dict.fromkeys(("preprocessing_version", "bridge_frames"), int),
    "track_seconds": float,
    "units": dict[str, str],
    "trained_on": dict[Literal["depth", "masks"], tuple[str, ...]] | None,
    "training": {"weights_sha256": str},
    "contact": {"press_seconds": tuple[float, float]},
    "calibration": {"whole": dict},
}
"""Types of the document's fields, as `fits` takes them; files may lack all but `input`."""


class ModelFileError(ValueError):
    """Error: a model file can't be used; the message is a sentence with the remedy."""


class ExportedModel:
    """A network in a file that `train.py export` or `palpate.estimators.network.calibration` wrote.

    Args:
        path: the file.
        threads: CPU threads for one call; None = ONNX Runtime's choice.
        device: one of `palpate.common.onnx_devices.DEVICES`.

    Raises:
        ModelFileError: the file is missing, no ONNX file, of another program or kind, newer than this program, or its
            metadata can't be used; or there is no such device.
    """

    outputs: tuple[str, ...] = ()
    """Names of the outputs of this kind."""

    def __init__(self, path: str | Path, threads: int | None = None, device: str = AUTO) -> None:
        self.path = Path(path)
        self._session, self.sha256 = _open_session(self.path, threads, device)
        """`sha256` is the hash of the opened content, even if the file changes later."""
        self.metadata: dict[str, Any] = _read_metadata(self.path, self._session)
        """Everything the export wrote: bounds, units, mechanics, preprocessing settings, calibration and versions."""
        size = self.metadata["input"]
        self.window: int = size["window"]
        """Frames in the depth window, K; the last is the current one."""
        self.input_size: tuple[int, int] = (size["height"], size["width"])
        """Height and width of the depth maps [pixels]."""
        self.inputs = {value.name: tuple(value.shape[1:]) for value in self._session.get_inputs()}
        """Shape of every input without the batch, by its name."""

    @property
    def provider(self) -> str:
        """Execution providers of ONNX Runtime that run the network."""
        return provider_of(self._session)

    def run(self, values: Mapping[str, np.ndarray | None]) -> list[np.ndarray]:
        """Outputs of this kind, float32, for a batch of inputs by their names.

        Raises:
            ValueError: an input is missing or has another shape.
            ModelFileError: the network fails, needs too much memory, or gives a number that is not finite.
        """
        for name, shape in self.inputs.items():
            actual = np.asarray(values[name]).shape
            if actual[1:] != shape or not actual:
                expected = ", ".join(map(str, shape))
                raise ValueError(f"{self.path}: {name} has shape {list(actual)}; expected [B, {expected}].")
        feed = {name: np.ascontiguousarray(values[name], np.float32) for name in self.inputs}
        try:
            found = [np.asarray(value) for value in self._session.run(self.outputs, feed)]
        except Exception as error:  # ONNX Runtime's exceptions have no common class
            raise ModelFileError(f"{self.path} can't be run; export it again with train.py export.") from error
        if not all(np.isfinite(values).all() for values in found):
            problem = "gives a number that is not finite; its training did not succeed, export another checkpoint"
            raise ModelFileError(f"{self.path} {problem}.")
        return found

    def _require(self, inputs: dict[str, tuple[int, ...]]) -> None:
        """Compare the graph's inputs and outputs with those of the kind and the metadata."""
        outputs = [value.name for value in self._session.get_outputs()]
        batches = [value.shape[0] for value in self._session.get_inputs() if value.shape]
        if any(isinstance(batch, int) for batch in batches):
            problem = f"takes batches of {batches[0]} alone; export it with a dynamic batch axis, as train.py does"
            raise ModelFileError(f"{self.path} {problem}.")
        if self.inputs != inputs or not set(self.outputs) <= set(outputs):
            raise ModelFileError(
                f"{self.path} takes {_described(self.inputs)} and gives {', '.join(outputs)}, not "
                f"{_described(inputs)} and {', '.join(self.outputs)}; export it again with train.py export."
            )


class ParameterModel(ExportedModel):
    """Encoder and parameter head of a trained generator: windows of depth maps → θ."""

    outputs = ("theta",)

    def __init__(self, path: str | Path, threads: int | None = None, device: str = AUTO) -> None:
        super().__init__(path, threads, device)
        self._require({INPUT: (self.window, *self.input_size)})

    def __call__(self, windows: np.ndarray) -> np.ndarray:
        """θ of windows of depth maps.

        Args:
            windows: depth normalised by the clip's fixed scale, 0 = invalid, shape [B, K, H, W].

        Returns:
            θ = [k_s, k_d, F] in scene units, F signed, shape [B, 3], float32.

        Raises:
            ValueError: another shape.
        """
        return self.run({INPUT: windows})[0]


class PosteriorModel(ExportedModel):
    """Contact features (and the depth window, where the file takes one) → mean and covariance of log θ."""

    outputs = (LOG_MEAN, LOG_COVARIANCE, EXPECTED_BOUND)

    def __init__(self, path: str | Path, threads: int | None = None, device: str = AUTO) -> None:
        super().__init__(path, threads, device)
        self.takes_depth = INPUT in self.inputs
        """True if the network takes the depth window as well."""
        depth = {INPUT: (self.window, *self.input_size)} if self.takes_depth else {}
        self._require({CONTACT: (self.inputs.get(CONTACT) or (0,))[:1]} | depth)
        whole = self.metadata.get("calibration", {}).get("whole", {})
        plain = json.loads(as_json(asdict(Widths())))
        self.calibrated = plain | whole != plain
        """True if its standard deviations are calibrated."""

    def __call__(
        self, contact: np.ndarray, depth: np.ndarray | None = None
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Posterior of contacts.

        Args:
            contact: vectors of `data.contact.features`, shape [B, features].
            depth: depth windows, shape [B, K, H, W], where the model takes them.

        Returns:
            Mean [B, 3] and calibrated covariance [B, 3, 3] of (log k_s, log k_d, log |F|), and the covariance [B, 3, 3]
            of their expected Cramér–Rao bound, by which the verdict is given; float64.

        Raises:
            ValueError: another shape.
        """
        mean, covariance, bound = self.run({CONTACT: contact, INPUT: depth})
        return mean.astype(np.float64), covariance.astype(np.float64), bound.astype(np.float64)


def open_model(path: str | Path, threads: int | None = None, device: str = AUTO) -> ParameterModel | PosteriorModel:
    """Open a file as the kind it is; arguments and errors as in `ExportedModel`."""
    posterior = ExportedModel(path, threads, device).metadata.get("head") == POSTERIOR
    return PosteriorModel(path, threads, device) if posterior else ParameterModel(path, threads, device)


def _open_session(path: Path, threads: int | None, device: str) -> tuple[onnxruntime.InferenceSession, str]:
    """Open an ONNX file; also the SHA-256 of its content.

    Raises:
        ModelFileError: no such file or device, or not an ONNX file.
    """
    if not path.is_file():
        raise ModelFileError(f"{path} is not a file; give the file that train.py export wrote.")
    try:
        # Largest size of a model file; this program's networks are smaller, and ONNX allows no more than twice that.
        content = read_file(path, (2**30))
        return open_session(content, threads or 0, device), hashlib.sha256(content).hexdigest()
    except DeviceError as error:
        raise ModelFileError(str(error)) from error
    except OSError as error:
        raise ModelFileError(f"{path} can't be read ({error.strerror}); check the file and its permissions.") from error
    except Exception as error:  # ONNX Runtime's exceptions have no common class
        raise ModelFileError(f"{path} {opening_problem(error)}.") from error


def _read_metadata(path: Path, session: onnxruntime.InferenceSession) -> dict[str, Any]:
    """Document that the export wrote into a file.

    Raises:
        ModelFileError: the file lacks the document, is newer than this program, or has a field that can't be used.
    """
    try:
        metadata = json.loads(session.get_modelmeta().custom_metadata_map[METADATA_KEY])
        version = metadata["format_version"]
        exported = fits(version, int) and set(_FIELDS["input"]) <= set(metadata["input"])
    except (KeyError, TypeError, ValueError, RecursionError):
        exported = False
    if not exported:
        problem = "is an ONNX file without palpate's metadata; give a file that train.py export wrote"
        raise ModelFileError(f"{path} {problem}.")
    if version > FORMAT_VERSION:
        problem = f"has format {reprlib.repr(version)} and this program reads up to {FORMAT_VERSION}"
        raise ModelFileError(f"{path} {problem}; update the program.")
    for name, value in metadata.items():
        if not (sound([name, value]) and fits(value, _FIELDS.get(name, Any))):
            problem = f"has unusable metadata, {reprlib.repr(name)}: {reprlib.repr(value)}"
            raise ModelFileError(f"{path} {problem}; export it again with train.py export.")
    return metadata


def _described(inputs: Mapping[str, tuple[int, ...]]) -> str:
    return ", ".join(f"{name} [{', '.join(map(str, ('batch', *shape)))}]" for name, shape in inputs.items())
