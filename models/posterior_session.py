"""Exported contact posteriors at inference: ONNX in, numpy out. No torch."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from models.calibration import Calibration
from models.onnx_session import INPUT, ModelFileError, open_session, read_metadata

CONTACT, LOG_MEAN, LOG_COVARIANCE, DECISIVE = "contact", "log_mean", "log_covariance", "decisive_covariance"
POSTERIOR = "posterior"
"""Value of the metadata's `head` for such a file."""


class PosteriorModel:
    """Contact features (and the depth window, where the file takes one) → mean and covariance of log θ.

    Args:
        path: file written by `models.posterior_export` or `train.py export`.
        threads: CPU threads for one call; None leaves the choice to ONNX Runtime.

    Raises:
        ModelFileError: no such file, not a posterior network of ours, or newer than this program.
    """

    def __init__(self, path: str | Path, threads: int | None = None) -> None:
        self.path = Path(path)
        self._session = open_session(self.path, threads)
        self.metadata: dict[str, Any] = read_metadata(self.path, self._session)
        """Everything the export wrote: bounds, units, mechanics, preprocessing settings, calibration and versions."""
        inputs = {value.name: list(value.shape) for value in self._session.get_inputs()}
        outputs = [value.name for value in self._session.get_outputs()]
        if CONTACT not in inputs or not {LOG_MEAN, LOG_COVARIANCE, DECISIVE} <= set(outputs):
            raise ModelFileError(
                f"{self.path} takes {', '.join(inputs)} and gives {', '.join(outputs)}, not {CONTACT} and {LOG_MEAN}, "
                f"{LOG_COVARIANCE}, {DECISIVE}; export it again."
            )
        size = self.metadata["input"]
        self.window: int = size["window"]
        """Frames in the depth window, K; the last is the current one."""
        self.input_size: tuple[int, int] = (size["height"], size["width"])
        """Height and width of the depth maps [pixels]."""
        self.features: int = inputs[CONTACT][1]
        """Length of the contact's vector."""
        self.takes_depth = INPUT in inputs
        """Whether it looks at the depth window as well."""
        plain = Calibration().document()["whole"]
        told = self.metadata.get("calibration", {}).get("whole", plain)
        if "decisive" in told:
            raise ModelFileError(
                f"{self.path} gives its verdicts by standard deviations, as an earlier version did; export it again."
            )
        self.calibrated = any(told.get(name, value) != value for name, value in plain.items())
        """Whether its standard deviations are more than the network's own."""

    def __call__(
        self, contact: np.ndarray, depth: np.ndarray | None = None
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Posterior of contacts.

        Args:
            contact: vectors of `data.contact_features`, shape [B, features].
            depth: depth windows, shape [B, K, H, W], where the model takes them.

        Returns:
            Of (log k_s, log k_d, log |F|): mean [B, 3], calibrated covariance [B, 3, 3], and the covariance [B, 3, 3]
            by whose standard deviations the verdict is given (`models.expected_bound.ExpectedBound`); float64.

        Raises:
            ValueError: another shape.
        """
        if contact.ndim != 2 or contact.shape[1] != self.features:
            raise ValueError(f"contact has shape {list(contact.shape)}; expected [B, {self.features}].")
        feed = {CONTACT: np.ascontiguousarray(contact, np.float32)}
        if self.takes_depth:
            if depth is None or depth.shape[1:] != (self.window, *self.input_size):
                raise ValueError(f"{self.path} takes depth windows [B, {self.window}, H, W] as well.")
            feed[INPUT] = np.ascontiguousarray(depth, np.float32)
        found = self._session.run([LOG_MEAN, LOG_COVARIANCE, DECISIVE], feed)
        mean, covariance, decisive = (values.astype(np.float64) for values in found)
        return mean, covariance, decisive
