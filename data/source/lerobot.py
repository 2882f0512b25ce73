"""Videos of LeRobot data sets: the camera and the episodes of a file.

Version 2 stores an episode a file, version 3 one after the other: there `VIDEO.mp4/episode_000003` is a clip's path.
"""

from os.path import isfile
from pathlib import Path

from palpate.data.source.images import printable
from palpate.data.source.layout import InputError
from palpate.data.source.table import reason


def file_of(clip: Path) -> Path:
    """File to read for a clip: the video that holds an episode, else the clip itself."""
    return clip.parent if isfile(clip.parent) else clip


def _place(video: Path) -> tuple[Path, Path] | None:
    """The data set of a video, and its path in the folder `videos`; None of other videos."""
    path = video.absolute()
    home = next((folder for folder in path.parents if folder.name == "videos"), None)
    known = home is not None and isfile(home.parent / "meta" / "info.json")
    return (home.parent, path.relative_to(home)) if home is not None and known else None


def name_in_data_set(clip: Path) -> str | None:
    """Camera and episode of a clip, as in `observation.images.top/episode_000003`; None of other videos."""
    video = file_of(clip)
    place = _place(video)
    if place is None:
        return None
    return (place[1].with_suffix("") if video == clip else Path(place[1].parts[0], clip.name)).as_posix()


def episodes_in(video: Path) -> dict[str, tuple[float, float]]:
    """Begin and end of the episodes in a file of version 3 [s], by name; empty for other files.

    Raises:
        InputError: they can't be read.
    """
    place = _place(video)
    if place is None or len(place[1].parts) != 3 or not video.stem.startswith("file-"):
        return {}
    camera, chunk, file = place[1].with_suffix("").parts
    names = [f"videos/{camera}/{name}" for name in ("from_timestamp", "to_timestamp", "chunk_index", "file_index")]
    try:
        import pyarrow.parquet as parquet

        table = parquet.read_table(place[0] / "meta" / "episodes", columns=["episode_index", *names]).to_pydict()
        rows = zip(*table.values(), strict=True)
        own = int(chunk.removeprefix("chunk-")), int(file.removeprefix("file-"))
        found = {f"episode_{number:06}": (begin, end) for number, begin, end, *at in rows if tuple(at) == own}
        if not found:
            raise ValueError("it names none of this file")
    except (ImportError, OSError, ValueError, KeyError, TypeError) as error:
        problem = f"can't be cut into episodes by meta/episodes ({reason(error).rstrip('.')}); copy that again"
        raise InputError(f"{printable(video)} {problem}, or install 'palpate[robot]', which reads it.") from error
    return found


def span_of(clip: Path) -> tuple[float, float] | None:
    """Begin and end of an episode in its video [s]; None for other clips.

    Raises:
        InputError: as in `episodes_in`, or the file holds no such episode.
    """
    video = file_of(clip)
    spans = {video / name: span for name, span in episodes_in(video).items()} or {video: None}
    if clip not in spans:
        raise InputError(f"{printable(clip)} is no clip in its file; give one, as {printable(next(iter(spans)))}.")
    return spans[clip]
