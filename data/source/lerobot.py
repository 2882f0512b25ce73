"""Videos of LeRobot data sets: which camera and episode a file shows."""

from os.path import isfile
from pathlib import Path

from palpate.data.source.images import printable
from palpate.data.source.layout import InputError, read_mapping


def name_in_data_set(video: Path) -> str | None:
    """Camera and episode of a video, as in `chunk-000/observation.images.top/episode_000000`; None of other videos.

    Raises:
        InputError: the file holds several episodes, as version 3 stores them, or nobody can read the set's description.
    """
    path = video.absolute()
    home = next((folder for folder in path.parents if folder.name == "videos"), path)
    about = home.parent / "meta" / "info.json"
    if home == path or not isfile(about):
        return None
    inner, episodes = path.relative_to(home), read_mapping(about, "a LeRobot data set").get("total_episodes")
    if inner.name.startswith("file-") and episodes != len(list((home / inner.parts[0]).glob("*/*.mp4"))):
        problem = "may hold several episodes; cut it at the times in meta/episodes, and give the pieces"
        raise InputError(f"{printable(video)} {problem}.")
    return inner.with_suffix("").as_posix()
