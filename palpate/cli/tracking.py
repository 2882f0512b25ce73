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

import yaml
from lightning.pytorch import LightningModule, Trainer
from lightning.pytorch.cli import SaveConfigCallback
from lightning.pytorch.loggers import MLFlowLogger
from lightning.pytorch.trainer.states import TrainerFn
from lightning.pytorch.utilities import rank_zero_only

from palpate.common.doors import by_interrupt
from palpate.common.files import as_json
from palpate.data.source.layout import InputError
from palpate.models.checkpoint import read_checkpoint
from palpate.results.record import sha256_of

RUN_ID = "mlflow_run_id"
"""Name under which a checkpoint holds its run's id."""
LOCK_TIMEOUT_S = 5.0
"""Longest wait for another program that has the tracking database locked [s]."""


class RunLogger(MLFlowLogger):
    """Lightning's logger, for a run that may go on: MLflow never changes parameters, so such a run keeps its first.

    Args:
        folder: the run folder; the database lies in the folder above.
        run_name: the run's in MLflow; none = the folder's, or as it is.
        checkpoint: goes on with the run of this one, where the database has it.
        prefix: of its metrics' names in MLflow.

    Raises:
        CheckpointError: the checkpoint can't be read.
    """

    def __init__(
        self, folder: Path, run_name: str | None = None, checkpoint: Path | None = None, prefix: str = ""
    ) -> None:
        root = folder.resolve().parent
        database = f"sqlite:///{root / 'mlflow.db'}"
        run_id = None if checkpoint is None else _run_of(checkpoint, database, run_name)
        place: dict[str, Any] = {"tracking_uri": database, "artifact_location": str(root / "mlflow"), "run_id": run_id}
        # One experiment holds all runs, and so compares them.
        super().__init__("palpate", run_name or folder.resolve().name, log_model="all", prefix=prefix, **place)
        self._goes_on = run_id is not None

    @rank_zero_only
    def log_hyperparams(self, params: Any) -> None:
        """Log a new run's parameters; `configs/` tells what a run goes on with."""
        if self._goes_on:
            self.experiment.update_run(self.run_id, status="RUNNING")
        else:
            super().log_hyperparams(params)


class RunRecord(SaveConfigCallback):
    """Callback that saves a run's configuration (in every checkpoint, too), and its data's digest."""

    def save_config(self, trainer: Trainer, pl_module: LightningModule, stage: str) -> None:
        """Log settings as parameters, and as configs/1_fit.yaml, configs/2_test.yaml, …; rank 0 alone calls this."""
        text, command = self.parser.dump(self.config), stage if stage == "export" else TrainerFn(stage).value
        settings = yaml.safe_load(text)
        data, run = settings["data"]["init_args"], {name: settings[name] for name in ("seed_everything", "trainer")}
        for logger in tracked(trainer):  # the model's settings are logged as its hyperparameters
            if command != "export":
                logger.log_hyperparams(run | {"data": data})
                if "root" in data:
                    log_data(logger, Path(data["root"]), command)
            number = len(logger.experiment.list_artifacts(logger.run_id, "configs")) + 1
            logger.experiment.log_text(logger.run_id, text, f"configs/{number}_{command}.yaml")

    def on_save_checkpoint(self, trainer: Trainer, pl_module: LightningModule, checkpoint: dict[str, Any]) -> None:
        checkpoint["configuration"] = self.parser.dump(self.config)
        for logger in tracked(trainer):
            checkpoint[RUN_ID] = logger.run_id

    def on_exception(self, trainer: Trainer, pl_module: LightningModule, exception: BaseException) -> None:
        if by_interrupt(exception) and trainer.state.fn == "fit":
            print("Interrupted. Add --ckpt_path last to the same command to go on after the last finished epoch.")


def loggers_of(
    folder: str, tracking: bool, name: str | None, checkpoint: str | None, command: str
) -> list[dict[str, Any]]:
    """Return settings of the loggers: CSV in the run folder, where config.yaml goes, too, then MLflow (see
    `RunLogger`).

    Raises:
        InputError: MLflow's database can't be used.
    """
    csv = {"class_path": "lightning.pytorch.loggers.CSVLogger", "init_args": {"save_dir": folder, "name": "logs"}}
    # What `validate` finds has no step, and would stand among the epochs of the training.
    prefix = "validate" if command == "validate" else ""
    run = {"folder": folder, "run_name": name, "checkpoint": checkpoint, "prefix": prefix}
    mlflow = {"class_path": f"{__name__}.{RunLogger.__name__}", "init_args": run}
    if not tracking:
        return [csv]
    root = Path(folder).resolve().parent
    root.mkdir(parents=True, exist_ok=True)
    _require_database(root / "mlflow.db")
    return [csv, mlflow]


def _run_of(checkpoint: Path, database: str, name: str | None) -> str | None:
    """Return the id of a checkpoint's run, which gets the name if one is given; None where it isn't in the database."""
    from mlflow import MlflowClient
    from mlflow.exceptions import MlflowException

    run_id, client = read_checkpoint(checkpoint).get(RUN_ID), MlflowClient(database)
    with contextlib.suppress(MlflowException):
        if isinstance(run_id, str) and client.get_run(run_id).info.lifecycle_stage == "active":
            client.update_run(run_id, name=name)
            return run_id
    return None


def tracked(trainer: Trainer) -> list[MLFlowLogger]:
    """Return MLflow's loggers of a trainer; none where nothing is tracked."""
    return [logger for logger in trainer.loggers if isinstance(logger, MLFlowLogger)]


def log_artifact(trainer: Trainer, path: Path, folder: str | None = None) -> None:
    """Copy a file to the run's MLflow artifacts, if the run is tracked."""
    for logger in tracked(trainer):
        if trainer.is_global_zero:
            logger.experiment.log_artifact(logger.run_id, str(path), folder)


def log_data(logger: MLFlowLogger, root: Path, command: str) -> None:
    """Log a data set to the run as its input: its name, where it lies, and the digest of its files."""
    from mlflow.entities import Dataset, DatasetInput, InputTag

    place = {"source_type": "local", "source": as_json({"uri": str(root)})}
    # MLflow's databases hold 36 characters.
    data = Dataset(name=root.resolve().name, digest=sha256_of(root)[:16], **place)
    logger.experiment.log_inputs(logger.run_id, [DatasetInput(data, [InputTag("mlflow.data.context", command)])])


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
