"""One clip from pictures to contacts: the one per-frame path, for training preparation and for inference.

Per frame: picture → labels → depth, free of lens distortion → grid → normalised depth → contact and mesh → status. With
the next frame: observed displacement and the contact's track (Bini 2026, sections 3.2.1 and 3.2.2).
"""

import dataclasses
import functools
import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from pathlib import Path

import numpy as np

from palpate.common.ahead import Item, ahead
from palpate.common.stages import StageSeconds
from palpate.data.cache import CacheEntry, PreparedClip, cache_key
from palpate.data.contact.clearance import MeasuredContacts
from palpate.data.contact.evidence import ContactEvidence
from palpate.data.contact.geometry import GeometryStatus, frame_geometry
from palpate.data.contact.instruments import InstrumentNumbers
from palpate.data.contact.light_contacts import LightContacts
from palpate.data.contact.motion import ContactMotion
from palpate.data.contact.tips import JAWS
from palpate.data.depth.normalise import estimate_scale, normalise, open_depth, resize_depth
from palpate.data.depth.shading import organ_shape
from palpate.data.depth.sources import DepthSource
from palpate.data.gaps import bridge_gaps, gap
from palpate.data.labels import TISSUE, UNSURE, MaskError
from palpate.data.masks.request import MaskSource
from palpate.data.masks.sources import chosen_kind, open_masks
from palpate.data.prepared import PreparedFrame
from palpate.data.settings import PrepareSettings
from palpate.data.source.camera import Camera, Undistortion, clip_camera
from palpate.data.source.frames import Frame, FrameSource, open_source
from palpate.data.source.layout import InputError
from palpate.data.source.repeats import mark_repeats

STAGES = 5
"""Number of concurrent pipeline stages: masks, preparation of a frame, contact, estimation and drawing."""
Noticed = Callable[[PreparedFrame], None] | None
"""Callback for every frame with what it and earlier ones tell of its contact, before later ones decide."""


class ClipStream:
    """Prepared frames of a clip, in order and one at a time, with one frame of look-ahead.

    No bad frame ends the stream: it comes with a status other than `ok` and a sentence in `detail`.
    """

    def __init__(
        self,
        source: FrameSource,
        settings: PrepareSettings,
        *,
        masks: MaskSource | None = None,
        depth: DepthSource | None = None,
        camera: Camera | None = None,
    ) -> None:
        """Open masks and depth, and fix the clip's scale and camera.

        Args:
            source: the pictures.
            settings: settings of the preparation.
            masks, depth, camera: sources for a clip without such files; None = the settings' choice.

        Raises:
            InputError: a model, preset, camera or clip file can't be used, or the camera is of another shape.
        """
        self.source, self.settings = source, settings
        self.seconds = StageSeconds()
        of_clip, runs = (settings.layout, settings.classes, source.path), settings.depth
        self._masks = masks or open_masks(
            settings.masks, *of_clip, threads=runs.threads, device=runs.device, every=settings.every
        )
        self._depth = depth or open_depth(settings.depth, settings.layout, source)
        self.guesses_depth = self._depth.from_picture
        """True if depth is guessed from the pictures alone, so that light is the measurement."""
        self.identity = self._depth.identity, self._masks.identity
        """Models and files on which depth and masks depend, besides the clip's own and settings."""
        chosen = Path(chosen_kind(settings.masks, source.path, settings.layout)).name
        self.sources = {"depth": self._depth.identity.split(":")[0], "masks": chosen}
        """Sources of depth and masks, a word each, on which a network trained on the clip depends."""
        camera, (width, height) = camera or clip_camera(source.path, settings.layout), source.size
        picture = None if camera is None else camera.scaled(width, height)
        if camera and picture and not settings.layout.halved:  # halves of one picture may be squeezed
            oblong = [abs(math.log(each.fx / each.fy)) for each in (camera, picture)]
            # Pictures that were cropped or turned have pixels more oblong by this, as a logarithm.
            if oblong[1] > oblong[0] + 0.1:
                own = f"{camera.width}x{camera.height}, another shape; give the camera of these pictures"
                raise InputError(f"{source.path} has pictures of {width}x{height}, and its camera is of {own}.")
        self._scale_error = ""
        self.scale, focal = math.nan, None
        """Depth that is z = 1 [unit of the depth source]; NaN if no frame has depth."""
        with self.seconds.timed("scale"):
            try:
                self.scale, focal = estimate_scale(source, self._depth, settings.depth)
            except InputError as error:
                self._scale_error = str(error)
        self.metres, self.warnings = self._depth.metres, self._depth.warnings
        """Length of a unit and warnings, as `DepthSource` has them."""
        if picture is None and focal is not None:
            picture = Camera.from_focal(focal, width, height)
        elif picture is None:
            picture = Camera.from_field_of_view(settings.depth.field_of_view_deg, width, height)
        self._undistortion = Undistortion(picture) if any(picture.distortion) else None
        self.picture_camera = dataclasses.replace(picture, distortion=())
        """Intrinsics of the full picture, after undistortion."""
        self.camera = self.picture_camera.scaled(settings.geometry.width, settings.geometry.height)
        """Intrinsics of the grid."""

    @property
    def providers(self) -> dict[str, str]:
        """Providers of ONNX Runtime that run the networks for `depth` and `masks`, of those that there are."""
        networks = {"depth": getattr(self._depth, "network", None), "masks": getattr(self._masks, "network", None)}
        return {name: network.provider for name, network in networks.items() if network is not None}

    def __iter__(self) -> Iterator[PreparedFrame]:
        """Prepared frames from the clip's beginning, one for each of its frames, up to some thirty frames late.

        Raises:
            InputError: the segmentation model fails on the clip's pictures.
        """
        return self.overlapped(0, 0)

    def overlapped(self, most: int = 2, decided: int = 4, noticed: Noticed = None) -> Iterator[PreparedFrame]:
        """Yield the same frames, while threads prepare the next ones and decide about their contact.

        Args:
            most: queue length in front of the decision, which adds to the latency [frames]; 0 = none, without a thread.
            decided: queue length in front of the caller, which may fit for seconds [frames]; 0 likewise.
            noticed: called in one of these threads.
        """
        self._masks.reset()
        motion = ContactMotion(self.camera, self.source.size, self.settings, from_shading=self._depth.from_shading)
        held: list[PreparedFrame] = []
        for prepared in _staged(self._judged(most, noticed), decided):
            held.append(prepared)
            if len(held) > 1:
                with self.seconds.timed("tracking"):
                    motion.link(*held[-2:])
                if motion.settled:
                    yield from held[:-1]
                    del held[:-1]
        motion.settle()
        yield from held

    def _judged(self, most: int, noticed: Noticed) -> Iterator[PreparedFrame]:
        """Frames with their contact decided, by the frames around them as well."""
        geometry = self.settings.geometry
        prepared = self._prepared(most, live=noticed is not None)
        frames = _staged(bridge_gaps(prepared, stored=not self.guesses_depth), most)
        if geometry.contact == "touching":
            near = geometry.contact_distance or math.inf
            if not self.guesses_depth:
                return self._decided(frames, MeasuredContacts(near, self.camera), noticed)
            frames = _staged(self._decided(frames, ContactEvidence(near), noticed), most)
            return self._decided(frames, LightContacts(self.camera, geometry))
        return map(functools.partial(_notify, noticed), frames)

    def _decided(
        self, frames: Iterator[PreparedFrame], contacts: ContactEvidence | LightContacts, noticed: Noticed = None
    ) -> Iterator[PreparedFrame]:
        """Frames once their contact is decided, which may be some frames later; `noticed` as they are by themselves."""
        for prepared in frames:
            with self.seconds.timed("contact"):
                decided = contacts.push(prepared)
            _notify(noticed, prepared)
            yield from decided
        yield from contacts.finish()

    def _masked(self, look_ahead: bool) -> Iterator[tuple[Frame, bool, np.ndarray | str]]:
        """Frames in order, whether each repeats the one before, and its label map, or why there is none."""
        frames = mark_repeats(self.source, look_ahead)
        while True:
            with self.seconds.timed("decode"):
                frame, repeats = next(frames, (None, False))
            if frame is None:
                return
            labels: np.ndarray | str = frame.error
            if frame.image is not None and not repeats:
                with self.seconds.timed("masks"):
                    try:
                        labels = self._masks(frame)
                    except MaskError as error:
                        labels = str(error)
            yield frame, repeats, labels

    def _prepared(self, most: int, *, live: bool) -> Iterator[PreparedFrame]:
        """Every frame by itself, in order; a caller that is live can't wait for later ones."""
        shape = (self.settings.geometry.height, self.settings.geometry.width)
        kept: np.ndarray | None = None
        instruments = InstrumentNumbers()
        masked = _staged(self._masked(not live), min(most, 1) if live else most)
        for count, (frame, repeats, labels) in enumerate(masked):
            if repeats:
                prepared = gap(frame, shape)
            else:
                prepared = self.prepared(frame, labels, kept if count % self.settings.every else None)
                prepared.instruments = instruments.push(prepared)
                kept = prepared.depth if self.guesses_depth and prepared.has_depth else None
            yield prepared

    def prepared(self, frame: Frame, shown: np.ndarray | str, depth_before: np.ndarray | None = None) -> PreparedFrame:
        """Everything about a frame that needs no other frame.

        Args:
            frame: frame of the clip.
            shown: its label map, uint8 [H, W], or why there is none.
            depth_before: z of a frame before, which is taken for this one's, shape [h, w] [scene units]; None = its
                own is found.
        """
        shape = (self.settings.geometry.height, self.settings.geometry.width)
        nothing, unlabelled = np.zeros(shape, np.float32), np.zeros(shape, np.uint8)
        if frame.image is None:
            return PreparedFrame(frame, "unreadable", frame.error, nothing, unlabelled)
        labels, mask_error = (None, shown) if isinstance(shown, str) else (shown, "")
        depth, depth_error = (nothing, "") if depth_before is not None else self._picture_depth(frame)
        if self._undistortion is not None:
            frame = dataclasses.replace(frame, image=self._undistortion.image(frame.image))
            depth = depth if depth_before is not None else self._undistortion.depth(depth)
            labels = None if labels is None else self._undistortion.labels(labels)
        with self.seconds.timed("geometry"):
            plain = np.zeros(frame.picture.shape[:2], np.uint8) if labels is None else labels
            known = np.where(plain == UNSURE, TISSUE, plain)
            # What of shading is shape is found on the grid.
            if depth_before is not None:
                z, grid_labels = depth_before, resize_depth(np.zeros(plain.shape, np.float32), known, shape)[1]
            elif self.settings.depth.rounded == "picture" and not self._depth.from_shading:
                depth_error = depth_error or self._beyond_scale(depth)
                depth = np.zeros_like(depth) if depth_error else normalise(depth, self.scale, self.settings.depth.bits)
                z, grid_labels = resize_depth(depth, known, shape)
            else:
                grid_depth, grid_labels = resize_depth(depth, known, shape)
                if self._depth.from_shading:
                    grid_depth = organ_shape(grid_depth, grid_labels == TISSUE, self.camera)
                depth_error = depth_error or self._beyond_scale(grid_depth)
                z = nothing if depth_error else normalise(grid_depth, self.scale, self.settings.depth.bits)
            if labels is None:
                return PreparedFrame(frame, "no_mask", mask_error, z, grid_labels)
            return self._judge(PreparedFrame(frame, "ok", "", z, grid_labels, labels), depth_error)

    def _picture_depth(self, frame: Frame) -> tuple[np.ndarray, str]:
        """Depth at the picture's size [unit of the depth source], or zeros and why there is none."""
        nothing = np.zeros(frame.picture.shape[:2], np.float32)
        if self._scale_error:
            return nothing, self._scale_error
        try:
            with self.seconds.timed("depth"):
                return self._depth(frame), ""
        except InputError as error:
            return nothing, str(error)

    def _beyond_scale(self, depth: np.ndarray) -> str:
        """Complaint about depth of which most would be cut off at z = 1: a flat wall that looks like tissue."""
        valid = depth[depth > 0]
        if len(valid) == 0 or np.median(valid) <= self.scale:
            return ""
        return (
            f"Half of the depth lies beyond the clip's scale of {self.scale:g} (median {np.median(valid):g}); "
            "check that depth_scale in clip.json or depth.scale is in the depth's own unit."
        )

    def _judge(self, prepared: PreparedFrame, depth_error: str) -> PreparedFrame:
        """Contact and mesh, or the status that says why there is none."""
        try:
            view = prepared.depth, prepared.labels, self.camera, self.settings.geometry
            # Guessed depth doesn't tell where along its free end an instrument touches.
            ends = prepared.ends_within(JAWS) if self.guesses_depth else prepared.ends
            geometry = frame_geometry(*view, ends=ends)
        except GeometryStatus as status:
            prepared.status, prepared.distance = status.status, status.distance
            prepared.detail = depth_error if status.status == "bad_depth" and depth_error else status.detail
        else:
            prepared.geometry, prepared.distance = geometry, geometry.distance
        return prepared


def _notify(noticed: Noticed, prepared: PreparedFrame) -> PreparedFrame:
    """Call back for a frame, after those that it has skipped; returns it."""
    if noticed is not None:
        for each in (*prepared.skipped, prepared):
            noticed(each)
    return prepared


def _staged(frames: Iterator[Item], most: int) -> Iterator[Item]:
    """Frames made by a thread of their own, of which `most` wait at most; 0 = made when they are asked for."""
    return ahead(frames, most) if most else frames


def prepare(
    path: Path | str,
    settings: PrepareSettings,
    cache_dir: Path | str,
    track: Callable[[ClipStream], Iterable[PreparedFrame]] = iter,
    following: Sequence[Path] = (),
) -> PreparedClip:
    """Prepare a clip once: from the cache where nothing that it depends on has changed, else frame by frame.

    The entry appears under its final name only when complete, so that an interruption leaves nothing half-written. Of
    several processes that prepare the same clip the first to finish wins.

    Args:
        path: frame folder or video file.
        settings: settings of the preparation.
        cache_dir: folder of the cache; made where it does not exist.
        track: gives the stream's frames one by one and may count them, as a progress bar does.
        following: frame folders that carry the first one on.

    Raises:
        InputError: the clip can't be prepared, or the cache can't be written.
    """
    path, source = Path(path), open_source(path, settings.layout, following)
    entry = CacheEntry(Path(cache_dir), source.name, cache_key(path, settings, following))
    found = entry.load(path)
    if found is not None:
        return found
    clip_stream = ClipStream(source, settings)
    entry.write(track(clip_stream), clip_stream.sources, source.size)
    found = entry.load(path)
    if found is None:
        raise InputError(f"{entry.folder} can't be read back; check the disk or give another cache.")
    return found
