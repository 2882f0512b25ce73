"""One MLflow run for all that is done with a training: settings, data, checkpoints, pictures and exported networks.

A checkpoint holds the id of its training's run, so that whoever goes on with it (fit, validate, test, export) goes on
with that run.
"""

import contextlib
import os
import sqlite3
import tempfile
from pathlib import Path
from typing import Any

os.environ.setdefault("MLFLOW_DISABLE_TELEMETRY", "true")  # read when mlflow is imported
os.environ.setdefault("DO_NOT_TRACK", "true")
os.environ.setdefault("MLFLOW_LOGGING_LEVEL", "WARNING")
os.environ.setdefault("MLFLOW_ENABLE_ARTIFACTS_PROGRESS_BAR", "false")

from lightning.pytorch import Trainer
from lightning.pytorch.loggers import CSVLogger, MLFlowLogger
from lightning.pytorch.utilities import rank_zero_only

from palpate.common.files import as_json
from palpate.data.source.layout import InputError
from palpate.models.checkpoint import read_checkpoint
from palpate.results.record import sha256_of

EXPERIMENT = "palpate"
"""Name of the experiment that holds the runs, and so compares them."""
RUN_ID = "mlflow_run_id"
"""Name under which a checkpoint holds its run's id."""
LOCK_TIMEOUT_S = 5.0
"""Longest wait for another program that has the tracking database locked [s]."""


class RunLogger(MLFlowLogger):
    """Lightning's logger, for a run that may go on: MLflow never changes parameters, so such a run keeps its first."""

    def __init__(self, name: str, run_id: str | None, **options: Any) -> None:
        super().__init__(EXPERIMENT, name, run_id=run_id, log_model="all", **options)
        self._goes_on = run_id is not None

    @rank_zero_only
    def log_hyperparams(self, params: Any) -> None:
        """Log a new run's parameters; `configs/` tells what a run goes on with."""
        if self._goes_on:
            self.experiment.update_run(self.run_id, status="RUNNING")
        else:
            super().log_hyperparams(params)


def run_loggers(
    folder: Path, tracking: bool, name: str | None = None, checkpoint: Path | None = None, prefix: str = ""
) -> list[CSVLogger | MLFlowLogger]:
    """A CSV logger in the run folder, where config.yaml goes as well, then MLflow in the folder above.

    Args:
        folder: the run folder.
        tracking: whether there is MLflow.
        name: the run's in MLflow; none = the folder's, or as it is.
        checkpoint: goes on with the run of this one, where the database has it.
        prefix: of its metrics' names in MLflow.

    Raises:
        InputError: the database can't be used.
        CheckpointError: the checkpoint can't be read.
    """
    loggers: list[CSVLogger | MLFlowLogger] = [CSVLogger(folder, name="logs")]
    if tracking:
        root = folder.resolve().parent
        root.mkdir(parents=True, exist_ok=True)
        _require_database(root / "mlflow.db")
        database = f"sqlite:///{root / 'mlflow.db'}"
        run_id = None if checkpoint is None else _run_of(checkpoint, database, name)
        place = {"tracking_uri": database, "artifact_location": str(root / "mlflow")}
        loggers.append(RunLogger(name or folder.resolve().name, run_id, prefix=prefix, **place))
    return loggers


def _run_of(checkpoint: Path, database: str, name: str | None) -> str | None:
    """Id of a checkpoint's run, which gets the name if one is given; none where it isn't in the database."""
    from mlflow import MlflowClient
    from mlflow.exceptions import MlflowException

    run_id, client = read_checkpoint(checkpoint).get(RUN_ID), MlflowClient(database)
    with contextlib.suppress(MlflowException):
        if isinstance(run_id, str) and client.get_run(run_id).info.lifecycle_stage == "active":
            client.update_run(run_id, name=name)
            return run_id
    return None


def tracked(trainer: Trainer) -> list[MLFlowLogger]:
    """MLflow's loggers of a trainer: none where nothing is tracked."""
    return [logger for logger in trainer.loggers if isinstance(logger, MLFlowLogger)]


def log_artifact(trainer: Trainer, path: Path, folder: str | None = None) -> None:
    """Copy a file to the run's MLflow artifacts, if the run is tracked."""
    for logger in tracked(trainer):
        if trainer.is_global_zero:
            logger.experiment.log_artifact(logger.run_id, str(path), folder)


def log_settings(logger: MLFlowLogger, settings: str, command: str) -> None:
    """Add a command's settings, as YAML, to the run's: configs/1_fit.yaml, configs/2_test.yaml, …"""
    number = len(logger.experiment.list_artifacts(logger.run_id, "configs")) + 1
    logger.experiment.log_text(logger.run_id, settings, f"configs/{number}_{command}.yaml")


def log_data(logger: MLFlowLogger, root: Path, command: str) -> None:
    """Log a data set to the run as its input: its name, where it lies, and the digest of its files."""
    from mlflow.entities import Dataset, DatasetInput, InputTag

    place = {"source_type": "local", "source": as_json({"uri": str(root)})}
    # MLflow's databases hold 36 characters.
    data = Dataset(name=root.resolve().name, digest=sha256_of(root)[:16], **place)
    given = DatasetInput(data, [InputTag("mlflow.data.context", command)])
    logger.experiment.log_inputs(logger.run_id, [given])


def _require_database(path: Path) -> None:
    """Refuse a file that is no tracking database, which would end in a traceback or in minutes of retries.

    Raises:
        InputError: the file can't be made, is no database, is damaged or locked, or of another program or version.
    """
    try:
        if not os.path.lexists(path):
            with tempfile.TemporaryFile(dir=path.parent):  # MLflow would try for minutes
                return
        if not path.is_file():
            raise sqlite3.DatabaseError("not a file")
        with contextlib.closing(sqlite3.connect(path, timeout=LOCK_TIMEOUT_S)) as database:
            [[verdict]] = database.execute("pragma quick_check(1)").fetchall()
            database.execute("begin immediate")  # refused while another program keeps it locked
            database.rollback()
        if verdict != "ok":
            raise sqlite3.DatabaseError(verdict)
        from mlflow import MlflowClient

        MlflowClient(f"sqlite:///{path}").search_experiments(max_results=1)
    except Exception as error:  # from SQLite, SQLAlchemy, Alembic or MLflow
        reason = " ".join(str(error).split())[:200]
        raise InputError(f"{path} can't be used ({reason}); move it away, or add --tracking false.") from error
