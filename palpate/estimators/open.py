"""Estimators by name, opened with their options, and the preparation of frames for them."""

from dataclasses import fields
from pathlib import Path
from typing import Any

from palpate.common.registry import Registry
from palpate.data.settings import PrepareSettings
from palpate.estimators.contract import Estimator, Preparation
from palpate.estimators.model_settings import check_sources
from palpate.models.onnx_session import ModelFileError, PosteriorModel, open_model

ESTIMATORS = Registry(
    "estimator",
    "palpate.estimators",
    {
        "network": "palpate.estimators.network.estimator:NetworkSettings",
        "gan": "palpate.estimators.gan:GanSettings",
        "direct": "palpate.estimators.direct.estimator:DirectSettings",
        "online": "palpate.estimators.online.estimator:OnlineOptions",
    },
)
"""Settings of every estimator: a frozen dataclass whose fields are its options, and whose `build` opens it."""


def default_estimator(model: str | Path | None) -> str:
    """Return the name of the estimator that a model's file is for; without a file, or with a wrong one, `network`."""
    try:
        of_network = model is None or isinstance(open_model(Path(model), 1, "cpu"), PosteriorModel)
        return "network" if of_network else "gan"
    except ModelFileError:
        return "network"  # which says what is wrong with it


def settings_of(name: str | None = None, **options: Any) -> Any:
    """Return an estimator's settings, whose `build` opens it.

    Args:
        name: of `ESTIMATORS`; None = the one that the option `model` is for.
        options: fields of its settings.

    Raises:
        ValueError: there is no such estimator, or an option isn't its own or can't be used.
    """
    name = name or default_estimator(options.get("model"))
    kind = ESTIMATORS[name]
    known = [field.name for field in fields(kind)]
    if unknown := [option for option in options if option not in known]:
        raise ValueError(f"{unknown[0]} is no option of the estimator {name}; choose from {', '.join(known)}.")
    return kind(**options)


def open_estimator(name: str | None = None, **options: Any) -> Estimator:
    """Open an estimator; one may serve many clips.

    Args:
        name: `network` (default), `gan`, `direct`, `online`, or that of another package's.
        options: fields of its settings, such as model, onset, observation and noise.

    Raises:
        ModelFileError: the model's file can't be used.
        ValueError: there is no such estimator, or an option isn't its own or can't be used.
    """
    return settings_of(name, **options).build()


def preparation(estimator: Estimator, chosen: Preparation) -> PrepareSettings:
    """Return how an estimator's frames are prepared, after opening the models that are named for it once.

    Raises:
        ValueError: something chosen can't be used, or not by this estimator.
    """
    settings = estimator.preparation(chosen)
    check_sources(settings)
    return settings
