"""Opens an exported network as the estimator that it is for."""

from __future__ import annotations

from pathlib import Path

from estimators.amortized import AmortizedEstimator
from estimators.contact_network import ContactNetwork
from estimators.onset import BETWEEN
from models.onnx_session import ModelFileError, ParameterModel, open_session, read_metadata
from models.posterior_session import POSTERIOR, PosteriorModel


def open_exported(
    path: Path, threads: int | None = None, onset: str | None = None
) -> AmortizedEstimator | ContactNetwork:
    """The estimator of a file that `train.py export` or `evaluation.calibration` wrote.

    Args:
        path: ONNX file.
        threads: CPU threads for one call; None leaves the choice to ONNX Runtime.
        onset: when a press begins, one of `estimators.onset.ONSETS`; None = between frames, as in real videos.

    Raises:
        ModelFileError: the file can't be used, or not with an onset.
    """
    if read_metadata(path, open_session(path, threads)).get("head") == POSTERIOR:
        return ContactNetwork(PosteriorModel(path, threads), onset or BETWEEN)
    if onset is not None:
        raise ModelFileError(f"{path} knows nothing of when a press begins; leave --onset {onset} out.")
    return AmortizedEstimator(ParameterModel(path, threads))
