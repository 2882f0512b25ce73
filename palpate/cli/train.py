"""Train, validate, test or export the parameter network, or train another one, from one configuration file.

    palpate train fit -c configs/paper.yaml [--trainer.max_epochs 5 …] [--ckpt_path last]
    palpate train validate|test -c configs/paper.yaml --ckpt_path best
    palpate train export -c configs/paper.yaml --ckpt_path best --output parameters.onnx
    palpate train fit -c configs/contact.yaml [--contact.contacts 3200 …]
    palpate train fit|validate -c configs/masks.yaml [--data.real DIR]

`--ckpt_path` is a file, or `best` or `last` of the run folder (`trainer.default_root_dir`), which also gets logs,
pictures and the evaluation. All commands log to one MLflow run, called by `--run_name`. Exit status: 0 done, 1 failed,
2 wrong usage, 130 interrupted.
"""

import argparse
import contextlib
import hashlib
import os
import sys
import warnings
from dataclasses import fields
from pathlib import Path
from typing import Any, Literal, NoReturn

import torch
import yaml
from jsonargparse import ActionConfigFile, Namespace
from lightning.pytorch import LightningModule, Trainer
from lightning.pytorch.callbacks import ModelCheckpoint, TQDMProgressBar
from lightning.pytorch.cli import LightningArgumentParser, LightningCLI, SaveConfigCallback
from lightning.pytorch.strategies import DDPStrategy
from lightning.pytorch.trainer.states import TrainerFn
from lightning.pytorch.utilities import disable_possible_user_warnings
from lightning.pytorch.utilities.exceptions import MisconfigurationException

from palpate.cli.tracking import RUN_ID, log_artifact, log_data, log_settings, run_loggers, tracked
from palpate.cli.train_masks import MasksCLI
from palpate.common.doors import INTERRUPTED, by_interrupt, interruptible, plain, program
from palpate.common.files import read_beside
from palpate.common.output import ForeignFile, require_own
from palpate.common.settings import shown, sound
from palpate.common.workers import WorkerLost
from palpate.data.contact.features import FEATURES
from palpate.data.contact.geometry import GeometrySettings
from palpate.data.contact.sequence_features import SEQUENCE_FEATURES
from palpate.data.source.layout import InputError, read_mapping
from palpate.data.training.datamodule import ClipDataModule
from palpate.data.training.instruments.datamodule import InstrumentData
from palpate.estimators.network.training import WEIGHTS, ContactSettings, TrainingError, train_contact
from palpate.models.checkpoint import CheckpointError, read_checkpoint, require_same_model, require_same_weights
from palpate.models.instruments.module import InstrumentSegmentation
from palpate.models.module import PhysicsInformedGAN, TrainingDiverged
from palpate.models.onnx_export import ParityError, export
from palpate.physics.mechanics import Bounds, Mechanics, UnstableConfiguration
from palpate.results.paper.report import FILES, EvaluationError, write_evaluation

CHECKPOINTS: dict[str, dict[str, Any]] = {
    "best": {"monitor": "val/physics"},
    "epoch_{epoch:03d}": {"every_n_epochs": 10, "save_top_k": -1},
    "last": {"every_n_epochs": 1},
}
"""Settings of the checkpoints by file name (Bini 2026, section 3.5). `save_last` would follow the best checkpoint only,
so `last` is a checkpoint of its own; it comes last because it holds the others' state."""
COMMANDS = ("fit", "validate", "test", "export")
MAX_SEED = 2**32 - 1
"""Largest seed of numpy's global generator."""

REFUSED: dict[str, dict[str, Any]] = read_beside(__file__)
"""Trainer options that can't be used freely."""
FAILURES = (InputError, TrainingDiverged, TrainingError, WorkerLost, ParityError, EvaluationError, ForeignFile)
"""Errors with exit status 1, each of which is a sentence."""


class UsageError(ValueError):
    """The command line or the configuration can't be followed, in one sentence."""


WRONG_USE = (UsageError, CheckpointError, UnstableConfiguration, MisconfigurationException)
"""Errors with exit status 2, likewise."""


class SentenceParser(LightningArgumentParser):
    """Reports errors in one sentence, without the list of all options."""

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

    def error(self, message: str, ex: Exception | None = None) -> NoReturn:
        sentence = " ".join(message.split()).rstrip(".")
        raise UsageError(f"{sentence}; {program()} {{fit,validate,test,export}} --help lists all options.") from ex


class RunRecord(SaveConfigCallback):
    """Saves a run's configuration (in every checkpoint, too), and its data's digest."""

    def save_config(self, trainer: Trainer, pl_module: LightningModule, stage: str) -> None:
        # Only rank 0 calls this.
        text, command = self.parser.dump(self.config), TrainerFn(stage).value
        settings = yaml.safe_load(text)
        for logger in tracked(trainer):  # the model's settings are logged as its hyperparameters
            logger.log_hyperparams({name: settings[name] for name in ("seed_everything", "trainer", "data")})
            log_settings(logger, text, command)
            log_data(logger, Path(settings["data"]["root"]), command)

    def on_save_checkpoint(self, trainer: Trainer, pl_module: LightningModule, checkpoint: dict[str, Any]) -> None:
        checkpoint["configuration"] = self.parser.dump(self.config)
        for logger in tracked(trainer):
            checkpoint[RUN_ID] = logger.run_id

    def on_exception(self, trainer: Trainer, pl_module: LightningModule, exception: BaseException) -> None:
        if by_interrupt(exception) and trainer.state.fn == "fit":
            print("Interrupted. Add --ckpt_path last to the same command to go on after the last finished epoch.")


class RunTrainer(Trainer):
    """Lightning's trainer with an `export` function."""

    def export(
        self,
        model: PhysicsInformedGAN,
        datamodule: ClipDataModule,
        ckpt_path: str | None = None,
        output: str = "parameters.onnx",
    ) -> None:
        """Write encoder and parameter head of a checkpoint as one ONNX file for infer.py.

        Args:
            model: network with the checkpoint's architecture.
            datamodule: preparation settings, which go into the file's metadata.
            ckpt_path: checkpoint file, or best or last of the run folder.
            output: file to write.
        """
        checkpoint = read_checkpoint(Path(ckpt_path))  # ty: ignore[invalid-argument-type]  the command line resolves it
        model.load_state_dict(checkpoint["state_dict"])
        datamodule.load_state_dict(checkpoint.get(ClipDataModule.__name__, {}))
        metadata: dict[str, Any] = {name: model.hparams[name] for name in ("bounds", "mechanics")}
        metadata |= datamodule.metadata()
        metadata["config_sha256"] = hashlib.sha256(checkpoint.get("configuration", "").encode()).hexdigest()
        geometry, generator = metadata["geometry"], model.generator_ab
        size = {"window": generator.channels, "height": geometry["height"], "width": geometry["width"]}
        difference = export(generator, Path(output), metadata | {"input": size})
        print(f"{output}: written; largest difference from torch over batches of 1, 2 and 7 is {difference:.1e}")


class TrainCLI(LightningCLI):
    """Command line: one configuration file, any field of which can be overridden."""

    def __init__(self, *given: Any, args: list[str] | None, **options: Any) -> None:
        """Set up the options of the command that is given alone; those of each take a third of a second."""
        first = (sys.argv[1:] if args is None else args)[:1]
        self._commands = [name for name in COMMANDS if name in first] or COMMANDS
        super().__init__(*given, args=args, **options)

    def subcommands(self) -> dict[str, set[str]]:
        loaders = {"model", "dataloaders", "train_dataloaders", "val_dataloaders", "datamodule", "weights_only"}
        return dict.fromkeys(self._commands, loaders)

    def add_arguments_to_parser(self, parser: LightningArgumentParser) -> None:
        parser.add_argument("--tracking", type=bool, default=True, help="Log to MLflow, next to the run folder.")
        parser.add_argument("--run_name", type=str | None, help="Name of the run in MLflow; null = the run folder's.")
        parser.link_arguments("data.samples.window", "model.window")
        inputs = ("data.samples.observation", "data.geometry.smoothing")
        parser.link_arguments(inputs, "model.contact_features", compute_fn=contact_features)
        for source, target, settings in (
            ("model.mechanics", "data.samples.mechanics", Mechanics),
            ("model.bounds", "data.bounds", Bounds),
            ("data.geometry", "data.samples.geometry", GeometrySettings),
        ):
            for field in fields(settings):
                parser.link_arguments(f"{source}.{field.name}", f"{target}.{field.name}")

    def parse_arguments(self, parser: LightningArgumentParser, args: Any) -> None:
        """Parse as Lightning does, and check that its libraries accept the seed."""
        super().parse_arguments(parser, args)
        seed = self.config[self.config.subcommand].seed_everything
        if isinstance(seed, int) and not 0 <= seed <= MAX_SEED:
            raise UsageError(f"seed_everything is {shown(seed)}; give 0 to {MAX_SEED}.")

    def _parse_ckpt_path(self) -> None:
        """Resolve and check `--ckpt_path`; Lightning's own method lets the checkpoint override the command line."""
        config, command = self.config[self.config.subcommand], self.config.subcommand
        if config.ckpt_path in ("best", "last"):
            folder = folder_of(config.trainer.default_root_dir, "checkpoints")
            path = folder / f"{config.ckpt_path}.ckpt"
            if command == "fit" and not any(folder.glob("*.ckpt")):
                print(f"There is no {path} yet; training starts from the beginning.")
                config.ckpt_path = None
                return
            config.ckpt_path = str(path)
        if config.ckpt_path is None:
            if command != "fit":
                raise UsageError(f"{command} needs a trained network; add --ckpt_path FILE, best or last.")
            return
        require_same_model(Path(config.ckpt_path), config.model.as_dict() | {"window": config.data.samples.window})

    def before_fit(self) -> None:
        """Refuse to replace the checkpoints of another training."""
        config = self.config[self.subcommand]  # ty: ignore[invalid-argument-type]  a command is required
        folder = folder_of(config.trainer.default_root_dir, "checkpoints")
        if any(folder.glob("*.ckpt")) and not resumes(config.ckpt_path, folder):
            raise UsageError(
                f"{folder.parent} holds a training already; add --ckpt_path last to go on with it, or give another "
                "--trainer.default_root_dir."
            )

    def before_instantiate_classes(self) -> None:
        config = self.config[self.subcommand]  # ty: ignore[invalid-argument-type]  a command is required
        trainer = config.trainer
        for name, refused in REFUSED.items():
            if trainer[name] not in refused["work"]:
                raise UsageError(f"trainer.{name} is {shown(trainer[name])}, and {refused['because']}.")
        for name in ("check_val_every_n_epoch", "val_check_interval"):
            if isinstance(trainer[name], (int, float)) and trainer[name] <= 0:
                raise UsageError(f"trainer.{name} is {trainer[name]}; give more than 0.")
        on_cpu = trainer.accelerator in (("cpu",) if torch.accelerator.is_available() else ("cpu", "auto"))
        if trainer.deterministic is True and not on_cpu:
            raise UsageError(
                "trainer.deterministic is true, and reflection padding has no deterministic gradient on a GPU; give "
                "warn, which makes the rest deterministic, or trainer.accelerator cpu."
            )
        allowed, devices = max(os.cpu_count() or 1, 2), str(trainer.devices)
        count = int(devices) if devices.removeprefix("-").isdecimal() else 1
        if not 1 <= count <= allowed and on_cpu:
            raise UsageError(f"trainer.devices is {devices}; give 1 to at most {allowed}, one for each core here.")

    def instantiate_classes(self) -> None:
        try:
            super().instantiate_classes()
        except (ValueError, MisconfigurationException) as error:  # from the check of a setting
            raise UsageError(str(error)) from error
        except TypeError as error:  # Lightning's, of a trainer's option
            raise UsageError(f"an option of trainer can't be used ({error}); correct it.") from error
        checkpoint = self.config_init[self.subcommand].ckpt_path
        if checkpoint is not None:
            require_same_weights(Path(checkpoint), self.model, self.subcommand or "")

    def instantiate_trainer(self, **kwargs: Any) -> Trainer:
        config = self.config_init[self.subcommand]
        folder = Path(config.trainer.default_root_dir)
        if config.trainer.logger in (None, True):
            # A training that begins with another one's weights is a run of its own.
            goes_on = self.subcommand != "fit" or resumes(config.ckpt_path, folder_of(folder, "checkpoints"))
            checkpoint = Path(config.ckpt_path) if config.ckpt_path and goes_on else None
            # What `validate` finds has no step, and would stand among the epochs of the training.
            prefix = "validate" if self.subcommand == "validate" else ""
            kwargs["logger"] = run_loggers(folder, config.tracking, config.run_name, checkpoint, prefix)
        always: dict[str, Any] = {"auto_insert_metric_name": False, "enable_version_counter": False}
        checkpoints = [
            ModelCheckpoint(folder_of(folder, "checkpoints"), name, save_on_train_epoch_end=True, **always, **when)
            for name, when in CHECKPOINTS.items()
        ]
        # Lightning's default bar is rich's where that is installed, which prints nothing outside a terminal.
        bars = [] if config.trainer.enable_progress_bar is False else [TQDMProgressBar()]
        self.trainer_defaults = self.trainer_defaults | {"callbacks": [*checkpoints, *bars]}
        trainer = super().instantiate_trainer(**kwargs)
        if isinstance(trainer.strategy, DDPStrategy):
            # Each of the three backward passes reaches a part of the parameters only.
            trainer.strategy._ddp_kwargs["find_unused_parameters"] = True
        return trainer

    def before_test(self) -> None:
        """Refuse before the test to replace a user's files by the evaluation's."""
        config = self.config[self.subcommand]  # ty: ignore[invalid-argument-type]  a command is required
        require_own(*(folder_of(config.trainer.default_root_dir, "evaluation") / name for name in FILES))

    def after_test(self) -> None:
        """Write the paper's table 2 and figure 3, the collapse check and the baselines."""
        if not self.trainer.is_global_zero:
            return
        folder = folder_of(self.trainer.default_root_dir, "evaluation")
        contacts = self.datamodule.interactions("train", 8)
        files = write_evaluation(self.model.test_records, contacts, self.model.mechanics, self.model.bounds, folder)
        for name, path in files.items():
            log_artifact(self.trainer, path, "evaluation")
            print(f"{name}: {path}")

    def after_export(self) -> None:
        """Log the settings and the network, where the run is tracked."""
        config = self.config[self.subcommand]  # ty: ignore[invalid-argument-type]  a command is required
        for logger in tracked(self.trainer):
            log_settings(logger, self._parser(self.subcommand).dump(config), "export")
        log_artifact(self.trainer, Path(config.output), "network")


CHOSEN: dict[str, Any] = {
    **{"trainer_class": RunTrainer, "parser_class": SentenceParser, "save_config_callback": RunRecord},
    **{"trainer_defaults": {"default_root_dir": "runs/train"}, "parser_kwargs": {"description": __doc__}},
    **{"seed_everything_default": 0, "auto_configure_optimizers": False},
}
"""How Lightning's command line is made."""
CHOSEN_MASKS = {name: CHOSEN[name] for name in ("parser_class", "seed_everything_default", "auto_configure_optimizers")}
"""Settings that are chosen for the training of masks."""


def contact_features(observation: str, smoothing: float) -> int:
    """Length of the contact's vector in the batches; 0 without the motion or its noise."""
    return FEATURES + SEQUENCE_FEATURES if observation == "trajectory" and smoothing > 0 else 0


def folder_of(run_folder: str | os.PathLike[str] | None, part: Literal["checkpoints", "evaluation"]) -> Path:
    """Folder of a run's checkpoints, or of the files that `test` writes."""
    return Path(run_folder or ".") / part


def resumes(checkpoint: str | None, folder: Path) -> bool:
    """Whether a training goes on from a checkpoint of its own folder of checkpoints."""
    return checkpoint is not None and Path(checkpoint).resolve().parent == folder.resolve()


def trained(arguments: list[str]) -> Literal["contact", "masks", "parameters"]:
    """What is to be trained, by the settings that a configuration or an option holds."""
    parser = argparse.ArgumentParser(add_help=False, allow_abbrev=False)
    parser.add_argument("-c", "--config", action="append", default=[])
    given, others = parser.parse_known_args(arguments)
    names = {option.removeprefix("--").partition("=")[0] for option in others if option.startswith("--")}
    with contextlib.suppress(InputError):  # the parser of the settings says what is wrong with the file
        for path in given.config:
            settings = read_mapping(Path(path), "a configuration")
            names |= {str(name) for name in settings}
            if isinstance(settings.get("model"), dict):
                names |= {f"model.{name}" for name in settings["model"]}
    sections = {name.partition(".")[0] for name in names}
    return "contact" if "contact" in sections else "masks" if "model.edge_weight" in names else "parameters"


def fit_contact(arguments: list[str]) -> None:
    """Train the contact posterior by the command line after `fit`."""
    parser = SentenceParser(prog=f"{program()} fit", description="Train the contact posterior.", allow_abbrev=False)
    parser.add_argument("-c", "--config", action=ActionConfigFile, help="Configuration file.")
    parser.add_class_arguments(ContactSettings, "contact")
    chosen = parser.parse_args(arguments)
    try:
        settings = ContactSettings(**chosen["contact"].as_dict())
    except ValueError as error:  # from the check of a setting
        raise UsageError(str(error)) from error
    if (settings.output / WEIGHTS).exists():
        raise UsageError(f"{settings.output} holds a finished training; give another output, or remove that folder.")
    try:
        with interruptible():
            train_contact(settings)
    except KeyboardInterrupt:
        text = f"Interrupted; {settings.output} holds no {WEIGHTS}; start the same command anew."
        print(plain(text), file=sys.stderr)
        raise


def main(arguments: list[str] | None = None) -> int:
    """Run the command line and return the exit status."""
    warnings.filterwarnings("ignore", message=".*LeafSpec.*")  # Lightning about torch's internals
    disable_possible_user_warnings()  # guesses about worker counts
    command = sys.argv[1:] if arguments is None else arguments
    try:
        kind = trained(command[1:])
        if command[:1] == ["fit"] and kind == "contact":
            fit_contact(command[1:])
        elif kind == "masks":
            with interruptible():
                MasksCLI(InstrumentSegmentation, InstrumentData, **CHOSEN_MASKS, args=arguments)
        else:
            with interruptible():
                TrainCLI(PhysicsInformedGAN, ClipDataModule, **CHOSEN, args=arguments)
    except (*WRONG_USE, *FAILURES) as error:
        text = str(error)
        status = 2 if isinstance(error, WRONG_USE) else 1
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
