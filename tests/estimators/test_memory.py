"""Sessions forget: what a session takes does not grow with the contacts that it has seen."""

import dataclasses
import gc
from pathlib import Path
from typing import Any

import pytest
import yaml

from palpate.data.prepared import PreparedFrame
from palpate.data.synthetic.settings import SceneSettings
from palpate.data.synthetic.source import open_synthetic
from palpate.estimators.contract import ClipInfo, Preparation
from palpate.estimators.open import settings_of
from palpate.estimators.records import InteractionEstimate
from tests.data.clips import make_clip

MEMORY = Path("/proc/self/statm")
PRESS = SceneSettings(width=214, height=120, depth_noise=0.001, frames=16, press_seconds=(0.2, 0.2))
GRIP = SceneSettings(width=214, height=120, action="grip", frames=20)
LARGEST = 2.5
"""Growth that the allocator's own unevenness may explain [MB]; 3 MB a contact were once lost."""


def taken() -> float:
    """Resident memory of this process [MB]."""
    gc.collect()
    return int(MEMORY.read_text().split()[1]) * 4096 / 1e6


def later(frame: PreparedFrame, by: int, fps: float) -> PreparedFrame:
    """Frame like this one, so many frames later."""
    source, start = frame.frame, frame.track_start + by if frame.track_start >= 0 else -1
    when = {"index": source.index + by, "number": source.number + by, "time_s": source.time_s + by / fps}
    return dataclasses.replace(frame, frame=dataclasses.replace(source, **when), track_start=start)


def growth(options: Any, scene: SceneSettings, contacts: int, apart: int = 0) -> tuple[int, float]:
    """What a session tells of a clip again and again, and how memory has grown since a tenth of it, or a contact [MB].

    Args:
        apart: frames between two of them.
    """
    estimator = options.build()
    clip = open_synthetic(make_clip(scene, 5), estimator.preparation(Preparation()))
    frames, info = list(clip), ClipInfo.of(clip)
    session, told, settled = estimator.start(info), 0, 0.0
    for contact in range(contacts):
        for frame in frames:
            said = session.push(later(frame, contact * (len(frames) + apart), 25.0))
            told += sum(isinstance(item, InteractionEstimate) or item.estimate is not None for item in said)
        if contact == max(contacts // 10, 1):  # an estimate is told once the next contact has begun
            settled = taken()
    return told, taken() - settled


pytestmark = [
    pytest.mark.acceptance,
    pytest.mark.skipif(not MEMORY.exists(), reason="memory is read from Linux' /proc"),
]


LONGER = dataclasses.replace(GRIP, frames=30)


@pytest.mark.parametrize(
    ("options", "scene", "contacts", "apart"),
    [
        pytest.param(settings_of("network"), PRESS, 21, 0, id="network"),
        pytest.param(settings_of("direct", onset="stamp"), PRESS, 5, 0, id="direct"),
        pytest.param(settings_of("direct"), LONGER, 7, 50, id="grips"),
    ],
)
def test_memory_is_flat_over_many_contacts(options: Any, scene: SceneSettings, contacts, apart) -> None:
    """One session, the same contact again and again; the first tenth fills caches.

    Grips are told as they end, since frames are missing between them.
    """
    told, grown = growth(options, scene, contacts, apart)
    assert told >= contacts - 1  # the last one is told by `finish`
    assert grown < LARGEST


def test_memory_of_the_online_estimator_is_flat_over_many_frames(tmp_path: Path) -> None:
    """Whose session lasts as long as the clip; of few particles, since time grows with them and not what is kept."""
    small = {"particles": 60, "mapping": {"steps": 3}, "stepping": {"iterations": 4}}
    (tmp_path / "online.yaml").write_text(yaml.safe_dump(small))
    _, grown = growth(settings_of("online", settings=tmp_path / "online.yaml"), GRIP, 7)
    assert grown < LARGEST
