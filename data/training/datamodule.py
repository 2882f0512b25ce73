"""Batches for training and interactions for evaluation, from a data set of clips."""

import dataclasses
from collections import Counter
from pathlib import Path
from typing import Any, Literal

import numpy as np
from lightning.pytorch import LightningDataModule
from lightning.pytorch.overrides.distributed import UnrepeatedDistributedSampler
from lightning.pytorch.utilities import rank_zero_info, rank_zero_warn
from torch.utils.data import DataLoader
from torch.utils.data.distributed import DistributedSampler

from palpate.common.settings import fits
from palpate.data.cache import PreparedClip
from palpate.data.contact.features import FEATURES
from palpate.data.contact.interaction import Interaction
from palpate.data.contact.sequence_features import SEQUENCE_FEATURES
from palpate.data.settings import NUMBERS, PREPROCESSING_VERSION, PrepareSettings
from palpate.data.source.layout import ClipLayout, InputError, load_layout
from palpate.data.training.batches import SampleDataset, collate
from palpate.data.training.preparation import join_folders, list_clips, prepare_all
from palpate.data.training.samples import SampleSettings, list_frames, make_interaction
from palpate.data.training.splits import SPLITS, LoadingSettings, Place, split_samples
from palpate.physics.mechanics import Bounds, require_stable


class ClipDataModule(LightningDataModule):
    """Pairs of consecutive frames in contact, split by video (Bini 2026, section 3.1).

    Args:
        root: folder of the data set.
        layout: YAML file with the names of the clips' files; none = CholecSeg8k's.
        cache: folder of prepared clips; shared between runs and processes.
        samples: choice of samples; train.py takes its geometry from `geometry`, its mechanics from the model.
        loading: splits and batches.
        bounds: admissible box, checked for stability on the training meshes; train.py takes it from the model.
        preparation: the other fields of PrepareSettings: depth, geometry, masks, classes, bridge_frames.
    """

    def __init__(
        self,
        root: str,
        layout: str | None = None,
        cache: str = "runs/cache",
        samples: SampleSettings = SampleSettings(),  # noqa: B008 (frozen)
        loading: LoadingSettings = LoadingSettings(),  # noqa: B008
        bounds: Bounds = Bounds(),  # noqa: B008
        **preparation: Any,
    ) -> None:
        super().__init__()
        self.root, self.cache = Path(root), Path(cache)
        self.samples, self.loading, self.bounds = samples, loading, bounds
        self.mechanics = samples.mechanics
        # jsonargparse reads this call: every field of PrepareSettings that it doesn't set is an option.
        self.preparation = PrepareSettings(
            layout=ClipLayout() if layout is None else load_layout(layout),
            track_seconds=self.mechanics.steps * self.mechanics.time_step,
            **preparation,
        )
        if samples.geometry != self.preparation.geometry:
            raise ValueError("samples.geometry differs from geometry; give both the same.")
        self.clips: list[PreparedClip] = []
        self.places: dict[str, list[Place]] = {}
        """Samples of each split."""
        self.left_out: Counter[str] = Counter()
        """Frames that give no sample, by reason."""
        self.trained_on: dict[str, list[str]] | None = None
        """Sources of depth and masks of a checkpoint's training clips."""

    @property
    def contact_features(self) -> int:
        """Length of the contact's vector in the batches; 0 without the motion or its noise."""
        told = self.samples.observation == "trajectory" and self.preparation.geometry.smoothing > 0
        return FEATURES + SEQUENCE_FEATURES if told else 0

    def prepare_data(self) -> None:
        """Prepare all clips into the cache; Lightning calls this in one process a node."""
        self._load(show=True)

    def setup(self, stage: str) -> None:
        """Read the prepared clips, list the samples and split them.

        Raises:
            InputError: no clip can be prepared, or none gives a sample.
            UnstableConfiguration: the admissible box can't be integrated on a training mesh.
        """
        if self.places:
            return
        clips = self._load(show=False)
        found: list[Place] = []
        for index, clip in enumerate(clips):
            frames, reasons = list_frames(clip, self.samples)
            found += [(index, frame) for frame in frames]
            self.left_out += reasons
        if not found:
            raise InputError(self._nothing_found())
        places, warning = split_samples(clips, found, self.loading)
        if warning:
            rank_zero_warn(f"{self.root} {warning}")
        if not places["train"]:
            raise InputError(f"{self.root} has no sample in the videos named to train on; name others.")
        trained = places["train"]
        if self.samples.observation == "trajectory":
            trained = [(clip, int(clips[clip].track_start[frame])) for clip, frame in trained]
        for clip, frame in sorted(set(trained)):
            mesh = clips[clip].mesh(frame)
            require_stable(mesh.springs, len(mesh.vertices), self.bounds, self.mechanics)
        self.places = places
        rank_zero_info(self.summary())

    def summary(self) -> str:
        """Sizes of the splits and frames left out, in two sentences."""
        sizes = ", ".join(f"{len(self.places[split])} {split}" for split in SPLITS)
        reasons = _listed(self.left_out) or "none"
        return f"{self.root}: samples {sizes}, from {len(self.clips)} clips. Frames left out: {reasons}."

    def train_dataloader(self) -> DataLoader:
        """Shuffled batches, in an order that depends on seed and epoch only, also if a run is resumed."""
        return self._loader("train", shuffle=True)

    def val_dataloader(self) -> DataLoader:
        """Batches in order."""
        return self._loader("val", shuffle=False)

    def test_dataloader(self) -> DataLoader:
        """Batches in order."""
        return self._loader("test", shuffle=False)

    def interactions(self, split: str, limit: int | None = None) -> list[Interaction]:
        """Contacts of a split for the simulator, evenly spaced if there are more than `limit`."""
        places = self.places[split]
        if limit is not None and len(places) > limit:
            places = [places[index] for index in np.linspace(0, len(places) - 1, limit).round().astype(int)]
        return [make_interaction(self.clips[clip], frame, self.samples) for clip, frame in places]

    def state_dict(self) -> dict[str, Any]:
        """Record of the data for a checkpoint: sources of the clips' depth and masks."""
        names = "depth", "masks"
        return {"trained_on": {name: sorted({clip.sources[name] for clip in self.clips}) for name in names}}

    def load_state_dict(self, state_dict: dict[str, Any]) -> None:
        """Take over a checkpoint's record, for `metadata`.

        Raises:
            InputError: the checkpoint holds no such record.
        """
        record = dict[Literal["depth", "masks"], tuple[str, ...]]
        if "trained_on" not in state_dict or not fits(state_dict["trained_on"], record):
            raise InputError("The checkpoint doesn't say what it was trained on; give one that train.py fit wrote.")
        self.trained_on = state_dict["trained_on"]

    def metadata(self) -> dict[str, Any]:
        """Settings that inference must repeat, as JSON values; they hold no file path of this machine."""
        depth = dataclasses.asdict(self.preparation.depth)
        for name in ("model", "threads", "device"):
            depth.pop(name)
        for name in ("source", "preset"):
            depth[name] = depth[name] and Path(depth[name]).name
        masks = self.preparation.masks
        return {
            "preprocessing_version": PREPROCESSING_VERSION,
            "geometry": dataclasses.asdict(self.preparation.geometry),
            "depth": depth,
            "masks": Path(masks).name,
            "trained_on": self.trained_on,
            "classes": dataclasses.asdict(self.preparation.classes),
            "observation": self.samples.observation,
            **{name: getattr(self.preparation, name) for name in NUMBERS},
        }

    def _load(self, *, show: bool) -> list[PreparedClip]:
        """All prepared clips, from the cache where it has them."""
        if not self.clips:
            clips, failures = prepare_all(self._found(), self.preparation, self.cache, show=show)
            if not clips:
                raise InputError(next(iter(failures.values())))
            for path, reason in failures.items():
                rank_zero_warn(f"{path.name} is left out: {reason}")
            guessed = [clip.name for clip in clips if clip.sources["depth"] == "photometric"]
            if guessed and self.preparation.depth.source == "auto":
                rank_zero_warn(
                    f"{self.root} has no stored depth in {len(guessed)} of {len(clips)} clips ({guessed[0]} first), so "
                    "their depth is the photometric model's, which is made from shading; give --data.depth.source (and "
                    "--data.depth.model) for a depth network."
                )
            self.clips = clips
        return self.clips

    def _found(self) -> dict[Path, tuple[Path, ...]]:
        """Clips to prepare, each with the folders that continue it; none reaches into another split."""
        layout = self.preparation.layout
        paths = list_clips(self.root, layout)
        if not self.loading.videos:
            return join_folders(paths, layout)
        try:
            divided = self.loading.videos.divide(paths)
        except ValueError as error:
            raise InputError(f"{self.root}: data.loading.videos names what is not there: {error}") from error
        return {first: rest for own in divided.values() for first, rest in join_folders(own, layout).items()}

    def _nothing_found(self) -> str:
        """Error message about a data set without samples."""
        statuses = _listed(sum((clip.counts for clip in self.clips), Counter()))
        if "ok" not in statuses:
            return (
                f"{self.root} has no frame in contact ({statuses}); check masks and classes, or raise "
                "geometry.contact_pixels or geometry.contact_distance."
            )
        remedy = "record longer contact, or choose data.samples.observation final"
        return f"{self.root} has frames in contact and no sample of them ({_listed(self.left_out)}); {remedy}."

    def _loader(self, split: str, *, shuffle: bool) -> DataLoader:
        dataset = SampleDataset(self.clips, self.places[split], self.samples)
        world, rank = (1, 0) if self.trainer is None else (self.trainer.world_size, self.trainer.global_rank)
        if not shuffle and 0 < len(dataset) < world:
            many = f"{len(dataset)} samples in split {split} for {world} processes"
            raise InputError(f"{self.root} has {many}; lower trainer.devices.")
        # This sampler keeps Lightning from adding one whose order ignores the seed of the settings. Only training may
        # repeat samples to give processes equal shares: elsewhere they would count twice.
        kind = DistributedSampler if shuffle else UnrepeatedDistributedSampler
        sampler = kind(dataset, world, rank, shuffle=shuffle, seed=self.loading.seed)
        return DataLoader(
            dataset,
            batch_size=self.loading.batch_size,
            sampler=sampler,
            num_workers=self.loading.num_workers,
            collate_fn=collate,
            persistent_workers=self.loading.num_workers > 0,
        )


def _listed(counts: Counter[str]) -> str:
    """Counts and their reasons as text, the most frequent first."""
    return ", ".join(f"{count} {reason}" for reason, count in counts.most_common())
