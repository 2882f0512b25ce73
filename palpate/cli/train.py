"""Train, validate, test or export a network, as its configuration file says.

    palpate train fit -c configs/paper.yaml [--trainer.max_epochs 5 …] [--ckpt_path last]
    palpate train validate|test -c configs/paper.yaml --ckpt_path best
    palpate train export -c configs/paper.yaml --ckpt_path best --output parameters.onnx
    palpate train fit -c configs/contact.yaml [--data.contacts 3200 …]
    palpate train fit|validate -c configs/masks.yaml [--data.real DIR]

Lightning's command line: a file names model and data by `class_path`, and any field can be overridden. `--ckpt_path` is
a file, or `best` or `last` of the run folder (`trainer.default_root_dir`), which also gets logs, pictures and the
evaluation. All commands log to one MLflow run, called by `--run_name`. Exit status: 0 done, 1 failed, 2 wrong usage,
130 interrupted.
"""

import importlib
import os
import re
import sys
import warnings
from collections.abc import Callable
from dataclasses import asdict
from pathlib import Path
from typing import Any, NoReturn

import torch
from jsonargparse import Namespace
from lightning.pytorch import Callback, LightningDataModule, LightningModule, Trainer
from lightning.pytorch.callbacks import ModelCheckpoint, TQDMProgressBar
from lightning.pytorch.cli import LightningArgumentParser, LightningCLI
from lightning.pytorch.utilities import disable_possible_user_warnings
from lightning.pytorch.utilities.exceptions import MisconfigurationException

from palpate.cli.tracking import RunRecord, log_artifact, loggers_of
from palpate.common.doors import INTERRUPTED, by_interrupt, interruptible, plain, program
from palpate.common.output import ForeignFile, require_own
from palpate.common.settings import shown, sound
from palpate.common.workers import WorkerLost
from palpate.data.contact.geometry import GeometrySettings
from palpate.data.source.layout import InputError, read_mapping
from palpate.data.training.contacts import TrainingError
from palpate.models.checkpoint import CheckpointError, read_checkpoint, require_same_model, require_same_weights
from palpate.models.module import PhysicsInformedGAN, TrainingDiverged
from palpate.models.onnx_export import ParityError
from palpate.physics.mechanics import Bounds, Mechanics, UnstableConfiguration
from palpate.results.paper.report import FILES, EvaluationError, write_evaluation


class UsageError(ValueError):
    """The command line or the configuration can't be followed, in one sentence."""


class SentenceParser(LightningArgumentParser):
    """Parser that reports errors in one sentence, without the list of all options."""

    def parse_path(self, cfg_path: str | os.PathLike[str], *arguments: Any, **options: Any) -> Namespace:
        """Read a configuration file as jsonargparse does, after checking that it can be read."""
        try:
            settings = read_mapping(Path(cfg_path), "a configuration")
        except InputError as error:
            raise UsageError(str(error)) from error
        if not sound(settings):
            raise UsageError(f"{cfg_path} nests too deeply, or holds a number out of range or a NUL; correct the file.")
        sections = {action.dest.partition(".")[0] for action in self._actions}
        unknown = [str(name) for name in settings if str(name).partition(".")[0] not in sections]
        if unknown:  # jsonargparse lets empty sections pass
            raise UsageError(f"{cfg_path}: the section {unknown[0]} is not accepted; correct or remove it.")
        return super().parse_path(cfg_path, *arguments, **options)

    def instantiate(self, namespace: Any, *given: Any, **options: Any) -> Any:
        """Build what the settings describe; what a class's own check refuses is wrong use."""
        try:
            return super().instantiate(namespace, *given, **options)
        except ValueError as error:
            while error.__cause__ is not None and str(error).startswith("Does not validate"):
                error = error.__cause__
            raise UsageError(str(error)) from error

    def error(self, message: str, ex: Exception | None = None) -> NoReturn:
        """Raise a UsageError that names an option in full, as it is typed."""
        sentence = " ".join(message.split()).rstrip(".")
        sentence = sentence.rpartition(" failed: ")[2] if "compute_fn" in sentence else sentence
        end = r"(?:; \S+ \{fit| - Expected a <|$)"
        nested = re.search(rf'Parser key "([\w.]+)": (?:Does not.*? Errors: - )?(.*?){end}', sentence)
        if nested is not None:
            section, problem = nested.groups()
            problem = re.sub(r"Group '([\w.]+)' does not accept option '(\w+)'", r"--\1.\2 is not accepted", problem)
            named = re.sub(r"(?:--|Option ')([\w.]+)'?", rf"--{section}.\1", problem)
            sentence = named if named != problem else f"--{section}: {problem}"
        raise UsageError(f"{sentence}; {program()} {{fit,validate,test,export}} --help lists all options.") from ex


class RunTrainer(Trainer):
    """Lightning's trainer with an `export` function."""

    def __init__(self, **options: Any) -> None:
        try:
            super().__init__(**options)
        except (TypeError, ValueError) as error:
            raise UsageError(f"an option of trainer can't be used ({error}); correct it.") from error

    def export(
        self, model: Any, datamodule: Any, ckpt_path: str | None = None, output: str = "parameters.onnx"
    ) -> None:
        """Write the network of a checkpoint as one file, as `palpate infer` reads it.

        Args:
            model: network with the checkpoint's architecture.
            datamodule: its data, whose settings go into the file's metadata.
            ckpt_path: checkpoint file, or best or last of the run folder.
            output: file to write.
        """
        checkpoint = read_checkpoint(path := Path(str(ckpt_path)))
        require_same_weights(path, model, "export")
        model.load_state_dict(checkpoint["state_dict"])
        datamodule.load_state_dict(checkpoint.get(type(datamodule).__name__, {}))
        print(model.export(Path(output), datamodule, checkpoint.get("configuration", "")))
        for callback in self.callbacks:  # ty: ignore[missing-attribute]  set by Lightning
            if isinstance(callback, RunRecord):
                callback.save_config(self, model, "export")
        log_artifact(self, Path(output), "network")


class RunFiles(Callback):
    """Callback that checks a checkpoint before it is followed, and writes the files of `fit` and `test` into the run
    folder.

    Args:
        checkpoint: that the command follows; None = a training begins.
        goes_on: whether it is one of this run.
    """

    def __init__(self, checkpoint: str | None, goes_on: bool) -> None:
        self._checkpoint, self._goes_on = checkpoint, goes_on

    def setup(self, trainer: Any, pl_module: Any, stage: str) -> None:
        """Refuse to replace the checkpoints of another training, and a checkpoint of other weights."""
        if self._checkpoint is not None:
            require_same_weights(Path(self._checkpoint), pl_module, str(trainer.state.fn.value))
        root = trainer.default_root_dir
        if stage == "fit" and not self._goes_on and any(Path(root, "checkpoints").glob("*.ckpt")):
            remedy = "add --ckpt_path last to go on with it, or give another --trainer.default_root_dir"
            raise UsageError(f"{root} holds a training already; {remedy}.")

    def on_fit_start(self, trainer: Trainer, pl_module: LightningModule) -> None:
        """Refuse before the training to replace a user's file by the network's."""
        if exported := getattr(pl_module, "EXPORTED", None):
            require_own(Path(trainer.default_root_dir) / exported)

    def on_fit_end(self, trainer: Any, pl_module: Any) -> None:
        if (exported := getattr(pl_module, "EXPORTED", None)) and trainer.is_global_zero:
            print(pl_module.export(Path(trainer.default_root_dir) / exported, trainer.datamodule))

    def on_test_start(self, trainer: Trainer, pl_module: LightningModule) -> None:
        """Refuse before the test to replace a user's files by the evaluation's."""
        require_own(*(Path(trainer.default_root_dir, "evaluation", name) for name in FILES))

    def teardown(self, trainer: Any, pl_module: Any, stage: str) -> None:
        """Write the paper's table 2 and figure 3, the collapse check and the baselines."""
        if not (stage == "test" and trainer.is_global_zero and isinstance(pl_module, PhysicsInformedGAN)):
            return
        contacts = trainer.datamodule.interactions("train", 8)
        folder = Path(trainer.default_root_dir, "evaluation")
        files = write_evaluation(pl_module.test_records, contacts, pl_module.mechanics, pl_module.bounds, folder)
        for name, path in files.items():
            log_artifact(trainer, path, "evaluation")
            print(f"{name}: {path}")


class TrainCLI(LightningCLI):
    """Lightning's command line with the command `export`, linked settings, and checks before anything is built."""

    @staticmethod
    def subcommands() -> dict[str, set[str]]:
        loaders = {"model", "dataloaders", "train_dataloaders", "val_dataloaders", "datamodule", "weights_only"}
        return dict.fromkeys(("fit", "validate", "test", "export"), loaders)

    def add_arguments_to_parser(self, parser: LightningArgumentParser) -> None:
        parser.add_argument("--tracking", type=bool, default=True, help="Log to MLflow, next to the run folder.")
        parser.add_argument("--run_name", type=str | None, help="Name of the run in MLflow; null = the run folder's.")
        links = (
            ("data.init_args.samples.window", "model.init_args.window", 1),
            ("model.init_args.mechanics", "data.init_args.samples.mechanics", asdict(Mechanics())),
            ("model.init_args.bounds", "data.init_args.bounds", asdict(Bounds())),
            ("data.init_args.geometry", "data.init_args.samples.geometry", asdict(GeometrySettings())),
        )
        # A setting, the one that follows it, and that one's default; Lightning leaves out what a class lacks.
        for source, target, default in links:
            parser.link_arguments((source, target), target, compute_fn=followed(source, target, default))
        features = "contact_features"
        parser.link_arguments(f"data.{features}", f"model.init_args.{features}", apply_on="instantiate")

    def _parse_ckpt_path(self) -> None:
        """Check the settings and resolve `--ckpt_path`; Lightning's own lets a checkpoint override the command line."""
        command = self.config.subcommand
        config = self.config[command]
        root = config.trainer.default_root_dir
        module, _, name = config.model.class_path.rpartition(".")
        model = getattr(importlib.import_module(module), name)
        require_usable(config, getattr(model, "REFUSED", {}))
        folder = Path(root or ".") / "checkpoints"
        config.ckpt_path = resolved(config, command, folder, getattr(model, "TRAINED", None))
        goes_on = config.ckpt_path is not None and Path(config.ckpt_path).resolve().parent == folder.resolve()
        if config.trainer.logger in (None, True):
            # A training that begins with another one's weights is a run of its own.
            path = config.ckpt_path if goes_on or command != "fit" else None
            try:
                config.trainer.logger = loggers_of(root, config.tracking, config.run_name, path, command)
            except InputError as error:
                raise UsageError(str(error)) from error
        always: dict[str, Any] = {"auto_insert_metric_name": False, "enable_version_counter": False}
        last = {"filename": "last", "every_n_epochs": 1, "save_on_train_epoch_end": True}
        checkpoints = [ModelCheckpoint(folder, **always, **when) for when in getattr(model, "CHECKPOINTS", [last])]
        # Lightning's default bar is rich's where that is installed, which prints nothing outside a terminal.
        bars = [] if config.trainer.enable_progress_bar is False else [TQDMProgressBar()]
        files = RunFiles(config.ckpt_path, goes_on)
        self.trainer_defaults = self.trainer_defaults | {"callbacks": [files, *checkpoints, *bars]}


def followed(source: str, target: str, default: Any) -> Callable[[Any, Any], Any]:
    """Return a link of a setting to the one that it follows, which refuses another value of its own."""

    def value(leading: Any, given: Any) -> Any:
        plain = given.as_dict() if isinstance(given, Namespace) else given
        if plain != default and given != leading:
            names = (name.replace("init_args.", "") for name in (target, source))
            raise ValueError("{} follows {}; give that one alone".format(*names))
        return leading

    return value


def require_usable(config: Namespace, refused: dict[str, tuple[tuple, str]]) -> None:
    """Refuse options of the trainer that don't work.

    Args:
        config: settings of a command.
        refused: values that work for this model and why no other does, by the option's name.

    Raises:
        UsageError: such an option.
    """
    trainer, seed, largest = config.trainer, config.seed_everything, 2**32 - 1  # of numpy's global generator
    if isinstance(seed, int) and not 0 <= seed <= largest:
        raise UsageError(f"seed_everything is {shown(seed)}; give 0 to {largest}.")
    for name, (work, because) in refused.items():
        if trainer[name] not in work:
            raise UsageError(f"trainer.{name} is {shown(trainer[name])}, and {because}.")
    for name in ("check_val_every_n_epoch", "val_check_interval"):
        if isinstance(trainer[name], (int, float)) and trainer[name] <= 0:
            raise UsageError(f"trainer.{name} is {trainer[name]}; give more than 0.")
    on_cpu = trainer.accelerator in (("cpu",) if torch.accelerator.is_available() else ("cpu", "auto"))
    if trainer.deterministic is True and not on_cpu:
        problem = "trainer.deterministic is true, and reflection padding has no deterministic gradient on a GPU"
        raise UsageError(f"{problem}; give warn, which makes the rest deterministic, or trainer.accelerator cpu.")
    allowed, devices = max(os.cpu_count() or 1, 2), str(trainer.devices)
    count = int(devices) if devices.removeprefix("-").isdecimal() else 1
    if not 1 <= count <= allowed and on_cpu:
        raise UsageError(f"trainer.devices is {devices}; give 1 to at most {allowed}, one for each core here.")


def resolved(config: Namespace, command: str, folder: Path, given: str | None = None) -> str | None:
    """Return the path of the checkpoint that a command follows, checked; None where a training begins.

    Args:
        config: settings of the command.
        command: fit, validate, test or export.
        folder: folder of the run's checkpoints.
        given: the model's setting that gives a trained network without a checkpoint; None = there is none.

    Raises:
        UsageError: there is none to follow.
        CheckpointError: the file can't be used with these settings.
    """
    path, settings = config.ckpt_path, config.model.init_args
    if path in ("best", "last"):
        path = str(folder / f"{path}.ckpt")
        if command == "fit" and not any(folder.glob("*.ckpt")):
            print(f"There is no {path} yet; training starts from the beginning.")
            return None
    if path is not None:
        require_same_model(Path(path), settings.as_dict())
    elif command != "fit" and not (given and settings[given]):
        raise UsageError(f"{command} needs a trained network; add --ckpt_path FILE, best or last.")
    return path


def main(arguments: list[str] | None = None) -> int:
    """Run the command line and return the exit status."""
    warnings.filterwarnings("ignore", message=".*LeafSpec.*")  # Lightning about torch's internals
    disable_possible_user_warnings()  # guesses about worker counts
    try:
        with interruptible():
            TrainCLI(
                *(LightningModule, LightningDataModule, RunRecord),
                **{"subclass_mode_model": True, "subclass_mode_data": True, "auto_configure_optimizers": False},
                **{"trainer_class": RunTrainer, "trainer_defaults": {"default_root_dir": "runs/train"}},
                **{"parser_class": SentenceParser, "parser_kwargs": {"description": __doc__}},
                **{"seed_everything_default": 0, "args": arguments},
            )
    except (UsageError, CheckpointError, UnstableConfiguration, MisconfigurationException) as error:
        text, status = str(error), 2
    except (
        InputError,
        TrainingDiverged,
        TrainingError,
        WorkerLost,
        ParityError,
        EvaluationError,
        ForeignFile,
    ) as error:
        text, status = str(error), 1
    except OSError as error:
        if error.strerror is None:  # the error is not from the file system
            raise
        where = error.filename or "The run folder"
        text, status = f"{where}: {error.strerror}; make room or choose another folder.", 1
    except Exception as error:
        from mlflow.exceptions import MlflowException  # as above

        if not isinstance(error, MlflowException):
            raise
        # The database was locked or lost during the run.
        reason = " ".join(str(error).split())[:200]
        text, status = f"tracking failed ({reason}); go on with --tracking false, a training with --ckpt_path last.", 1
    except (KeyboardInterrupt, SystemExit) as error:  # Lightning turns Ctrl-C into exit status 1
        if not by_interrupt(error):
            raise
        return INTERRUPTED
    else:
        return 0
    print(plain(f"{program()}: {text}"), file=sys.stderr)
    return status
