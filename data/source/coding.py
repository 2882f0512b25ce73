"""How a video is coded, and what the same coding does to other pictures.

A coder leaves out what isn't worth its bits. How much that is depends on its quantisation, which H.264 states block by
block.
"""

import io
from collections.abc import Iterable, Iterator
from fractions import Fraction
from pathlib import Path
from typing import NamedTuple

import av
import numpy as np
from av.container import InputContainer
from av.sidedata.sidedata import Type
from av.video.frame import PictureType
from av.video.stream import VideoStream

from palpate.data.source.decoding import opened
from palpate.data.source.layout import InputError
from palpate.data.source.video import X264, Video

LOOKED_AT = 32
"""First frames of a video that say how it is coded."""
H264_PARAMETERS = 1
"""FFmpeg's AV_VIDEO_ENC_PARAMS_H264."""
RATE = Fraction(25)
"""Of videos that are coded for comparison [1/s]; nothing but time stamps depends on it."""


class Coding(NamedTuple):
    """How a video is coded."""

    quantiser: float
    """Mean quantisation parameter of frames that are predicted from earlier ones."""
    bidirectional: bool
    """Whether other frames are predicted from later ones as well."""

    @property
    def step(self) -> float:
        """How far apart the means of a block of 8 × 8 pixels lie that H.264 can tell apart [levels of 8 bits]."""
        return 0.625 * 2 ** (self.quantiser / 6) / 8


def coding_of(path: Path) -> Coding | None:
    """How a video is coded; None where that isn't said (codecs other than H.264)."""
    try:
        with opened(path) as (container, track):
            found = [(kind, quantiser) for kind, quantiser, _ in _decoded(container, track, LOOKED_AT, pictures=False)]
    except (av.FFmpegError, InputError):
        return None
    return _coding(found)


def recoded(pictures: Iterable[np.ndarray], quality: float, bidirectional: bool) -> tuple[np.ndarray, Coding | None]:
    """Pictures after H.264, and how they were coded.

    Args:
        pictures: RGB, uint8 [H, W, 3] each, of even sides.
        quality: constant rate factor.
        bidirectional: as of `Coding`.

    Returns:
        Shape [T, H, W, 3], uint8, and the coding.
    """
    file, stream = io.BytesIO(), None
    with av.open(file, "w", format="matroska") as container:
        for picture in pictures:
            if stream is None:
                # One thread: several cut pictures into slices, as many as the machine has cores.
                options = {"crf": f"{quality:.2f}", "threads": "1"} | X264
                options |= {} if bidirectional else {"bf": "0"}
                stream = container.add_stream(Video.encoder, rate=RATE, options=options)
                stream.height, stream.width = picture.shape[:2]
                stream.pix_fmt = "yuv420p"
            container.mux(stream.encode(av.VideoFrame.from_ndarray(picture, format="rgb24")))
        if stream is not None:
            container.mux(stream.encode())
    file.seek(0)
    with av.open(file, "r") as container:
        found = list(_decoded(container, container.streams.video[0]))
    return np.stack([picture for *_, picture in found]), _coding([(kind, quantiser) for kind, quantiser, _ in found])


def _coding(frames: list[tuple[PictureType, float | None]]) -> Coding | None:
    predicted = [quantiser for kind, quantiser in frames if kind == PictureType.P and quantiser is not None]
    if not predicted:
        return None
    return Coding(float(np.mean(predicted)), any(kind == PictureType.B for kind, _ in frames))


def _decoded(
    container: InputContainer, stream: VideoStream, most: int | None = None, pictures: bool = True
) -> Iterator[tuple[PictureType, float | None, np.ndarray]]:
    """Kind, mean quantisation parameter and picture, RGB uint8 [H, W, 3], of the first frames."""
    nothing = np.empty(0)
    stream.codec_context.options = {"export_side_data": "venc_params"}
    for index, frame in enumerate(container.decode(stream)):
        if index == most:
            return
        said = frame.side_data.get(Type.VIDEO_ENC_PARAMS)  # ty: ignore[no-matching-overload]  a mapping by type
        quantiser = None if said is None else _mean_quantiser(bytes(said))
        yield PictureType(frame.pict_type), quantiser, frame.to_ndarray(format="rgb24") if pictures else nothing


def _mean_quantiser(said: bytes) -> float | None:
    """Of a frame's blocks, from FFmpeg's AVVideoEncParams and the AVVideoBlockParams behind it; None but for H.264."""
    places = ("u4", 0), ("u8", 8), ("u8", 16), ("i4", 24), ("i4", 28)
    blocks, offset, size, codec, quantiser = (int(np.frombuffer(said, kind, 1, at)[0]) for kind, at in places)
    if codec != H264_PARAMETERS:
        return None
    if not blocks:
        return float(quantiser)
    of_blocks = np.frombuffer(said, "i4", blocks * size // 4, offset).reshape(blocks, -1)[:, 4]
    return quantiser + float(of_blocks.mean())
