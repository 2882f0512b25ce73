"""Opens an exported network as the estimator that it is for."""

from __future__ import annotations

from pathlib import Path

from estimators.amortized import AmortizedEstimator
from estimators.contact_network import ContactNetwork
from models.onnx_session import ParameterModel, open_session, read_metadata
from models.posterior_session import POSTERIOR, PosteriorModel


def open_exported(path: Path, threads: int | None = None) -> AmortizedEstimator | ContactNetwork:
    """The estimator of a file that `train.py export` or `evaluation.calibration` wrote.

    Args:
        path: ONNX file.
        threads: CPU threads for one call; None leaves the choice to ONNX Runtime.

    Raises:
        ModelFileError: the file can't be used.
    """
    if read_metadata(path, open_session(path, threads)).get("head") == POSTERIOR:
        return ContactNetwork(PosteriorModel(path, threads))
    return AmortizedEstimator(ParameterModel(path, threads))
