"""Depth from a stereo pair, in metres: its rectification, and its disparity by semi-global matching.

Semi-global matching (Hirschmüller 2008, "Stereo processing by semiglobal matching and mutual information"; OpenCV's, in
three directions) finds disparities at a working size, and one step of Lucas and Kanade along the rows refines them.
"""

import math
from collections.abc import Sequence

import cv2
import numpy as np

from palpate.common.files import digest_of
from palpate.common.robust import trimmed_fit
from palpate.data.depth.model import RawDepth
from palpate.data.depth.sources import FARTHEST, DepthSource, check_map, positive
from palpate.data.source.camera import Camera, Rig, Undistortion, clip_camera
from palpate.data.source.frames import Frame, FrameSource, open_source
from palpate.data.source.images import printable, read_image
from palpate.data.source.layout import ClipLayout, InputError, companion, right_beside


class Rectification:
    """Brings a calibrated pair to common rows, and depth back to the left picture; a rectified pair stays as it is.

    Args:
        left: camera of the left picture, at its size.
        rig: with an `offset`.
    """

    def __init__(self, left: Camera, rig: Rig) -> None:
        offset, size = np.array(rig.offset, float), (left.width, left.height)
        self.product = left.fx * float(np.linalg.norm(offset))
        """Focal length times baseline: depth is this over disparity [px·m]."""
        self._lenses: list[Undistortion] = []
        straight = np.allclose(rig.turned, np.eye(3)) and not offset[1:].any()
        if straight and rig.right is None and not any(left.distortion):
            return
        cameras = left, (rig.right or rig).scaled(*size)
        first, second = [(each.matrix, np.array(each.distortion or [0.0] * 5)) for each in cameras]
        *turns, lens, lens_right = cv2.stereoRectify(*first, *second, size, rig.turned, offset[:, None])[:4]
        self.product = -float(lens_right[0, 3])
        self._lenses = [Undistortion(*each) for each in zip(cameras, turns, (lens, lens_right), strict=True)]
        pixels = np.indices(size[::-1], np.float32)[::-1].reshape(2, -1).T[:, None]
        back = cv2.undistortPoints(pixels, *first, R=turns[0], P=lens).reshape(*size[::-1], 2)
        self._back = cv2.split(back.astype(np.float32))
        rays = cv2.undistortPoints(pixels, *first).reshape(*size[::-1], 2) @ turns[0][2, :2]
        self._along = (rays + turns[0][2, 2]).astype(np.float32)

    def pictures(self, left: np.ndarray, right: np.ndarray) -> Sequence[np.ndarray]:
        """The pair on common rows, each [H, W, 3]."""
        return [lens.image(each) for each, lens in zip((left, right), self._lenses, strict=False)] or (left, right)

    def depth(self, disparity: np.ndarray) -> np.ndarray:
        """Depth in the unrectified left picture, [H, W] [m], from disparity on common rows [px]; 0 = none in both."""
        found = np.divide(self.product, disparity, out=np.zeros_like(disparity), where=disparity > 0)
        if not self._lenses:
            return found
        across, down = self._back
        return cv2.remap(found, across, down, cv2.INTER_NEAREST) / self._along


class SemiGlobal:
    """Semi-global matching with a left–right check.

    Args:
        size: width and height of the pictures [px].
        span: range of the disparities that are sought [px]; None = all up to half the width.
    """

    def __init__(self, size: tuple[int, int], span: tuple[float, float] | None = None) -> None:
        # Wider pictures are made smaller by a whole number until they are at most so wide, before they are matched
        # [px].
        parts = math.ceil(size[0] / 400)
        self._size = size[0] // parts, size[1] // parts
        low, high = np.multiply(span or (1, size[0] / 2), self._size[0] / size[0])
        least = max(1, int(low))
        count = 16 * max(1, math.ceil((high - least) / 16))
        # Blocks of 7 px are compared; disparities of both directions differ by 1 px at most; a match leads over the
        # next best by 5 %; islands of 100 px are removed, within which neighbours differ by 2 px at most.
        smooth = {"blockSize": 7, "P1": 8 * 7**2, "P2": 32 * 7**2, "mode": cv2.STEREO_SGBM_MODE_SGBM_3WAY}
        checks = {"disp12MaxDiff": 1, "uniquenessRatio": 5, "speckleWindowSize": 100, "speckleRange": 2}
        self._matcher, self._margin = cv2.StereoSGBM.create(least, count, **smooth, **checks), least + count

    def __call__(self, left: np.ndarray, right: np.ndarray) -> np.ndarray:
        """Disparity of a pair on common rows (RGB uint8, [H, W, 3]) at its working size, in its pixels; 0 = none."""
        grey = (cv2.cvtColor(each, cv2.COLOR_RGB2GRAY) for each in (left, right))
        small = [cv2.resize(each, self._size, interpolation=cv2.INTER_AREA) for each in grey]
        # OpenCV leaves out as many columns as it seeks disparities; most of them the right picture shows, too.
        wide = [cv2.copyMakeBorder(each, 0, 0, self._margin, 0, cv2.BORDER_REPLICATE) for each in small]
        found = self._matcher.compute(*wide)[:, self._margin :].astype(np.float32) / 16
        valid = (found >= self._matcher.getMinDisparity()) & (found <= np.arange(self._size[0]))
        return np.where(valid, _refined(*small, found), 0)


def _refined(left: np.ndarray, right: np.ndarray, disparity: np.ndarray) -> np.ndarray:
    """Disparities moved to where brightness agrees best, up to a constant, in a window of 9 px around each pixel."""
    rows, columns = np.indices(disparity.shape, np.float32)
    there = cv2.remap(right, columns - disparity, rows, cv2.INTER_LINEAR).astype(np.float32)
    slope, error = cv2.Sobel(there, cv2.CV_32F, 1, 0, ksize=1, scale=0.5), left - there

    def mean(values: np.ndarray) -> np.ndarray:
        return cv2.boxFilter(values, -1, (9, 9))

    steepness = mean(slope)
    shared = mean(slope * error) - steepness * mean(error)
    # Where it is flat, a slope has a variance of 2, which is noise alone.
    return disparity - np.clip(shared / (mean(slope * slope) - steepness**2 + 2.0), -1, 1)


def row_offsets(left: np.ndarray, right: np.ndarray) -> np.ndarray:
    """Offset of features down from the right to the left picture, as a linear function of their place in the left one.

    Args:
        left, right: pictures, shape [H, W, 3].

    Returns:
        a, b, c of a + b·x + c·y with x and y from the picture's centre [px], shape [3]; NaN if too few agree.
    """
    finder, height, width = cv2.SIFT.create(1500, contrastThreshold=0.01), *left.shape[:2]
    found = [finder.detectAndCompute(cv2.cvtColor(each, cv2.COLOR_RGB2GRAY), None) for each in (left, right)]
    if any(features is None for _, features in found):
        return np.full(3, np.nan)
    pairs = cv2.BFMatcher(cv2.NORM_L2, crossCheck=True).match(found[0][1], found[1][1])
    here = np.array([found[0][0][pair.queryIdx].pt for pair in pairs]).reshape(-1, 2)
    across, down = (here - np.array([found[1][0][pair.trainIdx].pt for pair in pairs]).reshape(-1, 2)).T
    near = (across > 0) & (across < width / 2) & (np.abs(down) < height / 4)
    terms = np.column_stack([np.ones(near.sum()), here[near] - [(width - 1) / 2, (height - 1) / 2]])
    fewest = 30  # features that tell
    if len(terms) < fewest:
        return np.full(3, np.nan)
    off = down[near] - (middle := np.median(down[near]))
    agree = np.abs(off - trimmed_fit(terms, off, 6, 2.0)) < 2.0
    enough = agree.sum() >= max(fewest, 0.3 * len(agree))
    return np.linalg.lstsq(terms[agree], off[agree] + middle, rcond=None)[0] if enough else np.full(3, np.nan)


class StereoDepth(DepthSource):
    """Depth of a stereo pair, in metres by its baseline; pixels that match nowhere, or not both ways, have none."""

    depends_on_clip = True
    not_compared = "left and right pictures share too few features to compare rows; look whether they are a pair"
    disparity_sd = 0.25
    """Standard deviation of the error that all disparities share [px], inflated by the offset of the rows: a camera
    that is turned that far may be turned as far across them."""

    def __init__(self, layout: ClipLayout, source: FrameSource) -> None:
        """
        Args:
            layout: states the place of the right pictures.
            source: the left ones.

        Raises:
            InputError: the place of the right pictures, or the baseline, isn't stated.
        """
        clip, rig, named = source.path, clip_camera(source.path, layout), printable(source.path)
        if layout.right is None:
            raise InputError(f"{named} has no right pictures; say in a layout file where they are, live by --right.")
        if clip.is_dir() and not layout.halved and "{number}" not in layout.right:
            raise InputError(f"{named} is a folder and layout.right is '{layout.right}'; write {{number}} in it.")
        if rig is None or rig.offset is None:
            raise InputError(f"{named} has no camera with a baseline; give a camera file with one, in metres.")
        self._clip, self._layout, self._size, self._pattern = clip, layout, source.size, layout.right
        self._rectification = Rectification(rig.scaled(*source.size), rig)
        self._baseline_log_sd = rig.baseline_sd / math.hypot(*rig.offset)
        self._match = SemiGlobal(source.size)
        self._before: tuple[int, np.ndarray] = (-2, np.zeros(0))
        self._seconds, self._second = iter(()), math.inf
        self.identity = f"stereo:{digest_of([repr(rig), layout.right])[:16]}"
        first = next((frame for frame in source if frame.image is not None), None)
        self._moved = None if first is None else self._onto_rows(first)

    def observe(self, frame: Frame) -> RawDepth:
        """The frame's depth; InputError where its right picture is missing or is of another size."""
        left, right = self._rectification.pictures(frame.picture, self._right(frame))
        if self._moved is not None:
            how = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
            right = cv2.warpAffine(right, self._moved, self._size, flags=how, borderMode=cv2.BORDER_REPLICATE)
        disparity, (index, before) = self._match(left, right), self._before
        if index == frame.index - 1:
            # Noise falls to 0.7 of its own where disparity is near the frame's before [working px]; what moves by less
            # lags by half a frame.
            same = (np.abs(disparity - before) < 0.25) & (disparity > 0) & (before > 0)
            disparity = np.where(same, 2 / 3 * disparity + (1 - 2 / 3) * before, disparity)
        self._before = frame.index, disparity
        full = cv2.resize(disparity, self._size, interpolation=cv2.INTER_NEAREST)
        depth = self._rectification.depth(full * np.float32(self._size[0] / disparity.shape[1]))
        check_map(depth, f"Stereo depth of frame {frame.number} of {printable(self._clip)}", signed=False)
        return RawDepth(positive(depth))

    def _right(self, frame: Frame) -> np.ndarray:
        """The right picture of a frame, [H, W, 3]."""
        file, picture = right_beside(self._clip, self._layout) or self._clip, frame.right
        if picture is None and frame.path is not None:
            file = companion(self._layout, frame.path, self._pattern)
            picture = read_image(file)
        elif picture is None:
            # A second video is read on, or again from its start.
            if frame.index <= self._second:
                self._seconds = iter(open_source(file, self._layout))
            self._second = frame.index
            picture = next((other.image for other in self._seconds if other.index == frame.index), None)
        if picture is None:
            raise InputError(f"{printable(file)} has no frame {frame.number}; give a right picture for every left one.")
        if picture.shape != frame.picture.shape:
            sizes = " while its left picture is ".join(f"{p.shape[1]}x{p.shape[0]}" for p in (picture, frame.picture))
            raise InputError(f"{printable(file)} is {sizes}; give both at one size.")
        return picture

    def _onto_rows(self, frame: Frame) -> np.ndarray | None:
        """Affine motion that brings the right pictures' rows to the left ones', [2, 3]; None = they coincide.

        Raises:
            InputError: they lie too far off, or features match the other way round alone.
        """
        pair = self._rectification.pictures(frame.picture, self._right(frame))
        found = row_offsets(*pair)
        if (unknown := np.isnan(found).any()) and np.isfinite(row_offsets(*pair[::-1])).all():
            raise InputError(f"Left and right pictures of {printable(self._clip)} are swapped; exchange them.")
        offset, turn, stretch = np.nan_to_num(found)
        x, y = ((side - 1) / 2 for side in self._size)
        most = abs(offset) + abs(turn) * x + abs(stretch) * y
        if most > 0.02 * self._size[1]:
            problem = f"The pair of {printable(self._clip)} is not rectified (its rows are up to {most:.0f} px apart);"
            remedy = "rectify it, or give rotation and translation of its calibration in the camera file."
            raise InputError(f"{problem} {remedy}")
        differ = (
            f"rows of the right pictures lie up to {most:.1f} px off those of the left ones and were brought together "
            "by features, so that depth may be off as well; rectify the pair"
        )
        self.warnings = [self.not_compared] if unknown else [differ] if most > 1.5 else []
        self.disparity_sd = math.hypot(self.disparity_sd, most)
        # A turn of the camera around its axis, which the rows tell, moves columns as well.
        moved = np.array([[1, turn, -turn * y], [-turn, 1 - stretch, turn * x + stretch * y - offset]])
        return moved if most > 0.3 else None

    def freeze(self, samples: Sequence[RawDepth]) -> None:
        """Fix the search range of disparities, and the uncertainty of the depth's scale."""
        found = np.concatenate([self._rectification.product / raw.values[raw.values > 0] for raw in samples])
        low, high = np.quantile(found, (0.01, 0.99)) * (0.7, 1.3)
        self._match = SemiGlobal(self._size, (float(low), float(high)))
        if (away := self._rectification.product / np.median(found)) > FARTHEST:
            text = f"would be {away:.3g} m away by its camera's baseline; give that in metres"
            raise InputError(f"Tissue of {printable(self._clip)} {text}.")
        off = self.disparity_sd / float(np.median(found))
        if self.not_compared not in self.warnings:
            self.metres = 1.0, math.hypot(self._baseline_log_sd, off), "stereo"
