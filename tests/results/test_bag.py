"""Bags of --bag, read again by their own library: what is on which topic, when, along what; and what isn't there."""

import dataclasses
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from rosbags.highlevel import AnyReader
from rosbags.typesys import Stores, get_typestore

from palpate.data.source.frames import open_source
from palpate.data.source.layout import ClipLayout
from palpate.estimators.records import FrameEstimate, InteractionEstimate
from palpate.estimators.result import ENDS
from palpate.results.artefacts.bag import write_bag
from palpate.results.artefacts.forces import ContactForce, forces_record
from palpate.results.store import BAGS
from tests.data.bags import BEGIN, RATE
from tests.data.bags import write_bag as write_given
from tests.estimators.estimates import CONTACT, GOOD, NONE
from tests.results.fields import GRIP

STEP = RATE / 1e9
NEWTONS = {"determined": "force", "force": 0.5, "force_low": 0.4, "force_high": 0.625, "force_unit": "N, by stiffness"}
SOURCE = SimpleNamespace(path=Path("clip.mp4"), begin_ns=0, frame_id="camera_optical_frame")


def contacts(*runs: InteractionEstimate, count: int = 24, calibrated: tuple = ()) -> list[dict]:
    """What forces.json has of runs, the last frame of each of which is the one before the next run's onset."""
    onsets = [run.onset for run in runs]
    frames = [FrameEstimate(at, STEP * at, "ok", contact=at + 1 not in onsets) for at in range(count)]
    found = [ContactForce.of(run, frames[:end]) for run, end in zip(runs, [*onsets[1:], count], strict=True)]
    return forces_record(found, frames, 25.0, calibrated)["contacts"]


def at(run: InteractionEstimate, onset: int) -> InteractionEstimate:
    return dataclasses.replace(run, onset=onset, onset_frame=onset, onset_time_s=STEP * onset)


def read(path: Path) -> dict[str, list]:
    """Messages by topic: time of recording [ns], then the verdict, or the header's time, frame, force and torque."""
    found: dict[str, list] = {}
    with AnyReader([path], default_typestore=get_typestore(Stores.LATEST)) as reader:
        for connection, recorded, content in reader.messages():
            message = reader.deserialize(content, connection.msgtype)
            if connection.msgtype == "std_msgs/msg/String":
                said = (message.data,)
            else:
                assert connection.msgtype == "geometry_msgs/msg/WrenchStamped"
                stamp, wrench = message.header.stamp, message.wrench
                vectors = [[each.x, each.y, each.z] for each in (wrench.force, wrench.torque)]
                said = (stamp.sec * 10**9 + stamp.nanosec, message.header.frame_id, *vectors)
            found.setdefault(connection.topic, []).append((recorded, *said))
    return found


@pytest.mark.parametrize("kind", BAGS)
def test_presses_and_pulls_are_on_topics_that_say_their_unit(tmp_path: Path, kind: str) -> None:
    """A press in newtons from 0 s on, a relative one that is unknown after its last observation, and a pull."""
    grip = dataclasses.replace(GRIP, times=STEP * np.array([0, 1, 2, 5]), force=np.array([0.5, 2, 1, 1]))
    pull = at(dataclasses.replace(NONE, grip=dataclasses.replace(grip, force_sd=np.full(4, 0.1))), 16)
    runs = at(GOOD, 0), dataclasses.replace(at(GOOD, 4), load_s=None), pull
    write_bag(kind, SOURCE, tmp_path, contacts(*runs, calibrated=(NEWTONS | {"onset_frame": 0},)))
    assert [path.name for path in tmp_path.iterdir()] == [BAGS[kind]]
    said = read(tmp_path / BAGS[kind])
    assert set(said) == {"/palpate/verdict", *(f"/palpate/{x}force{end}" for x in ("", "relative_") for end in ENDS)}
    verdicts, zero = ("determined", "determined", pull.verdict), [0, 0, 0]
    assert said["/palpate/verdict"] == [*zip((1, 4 * RATE, 16 * RATE), verdicts, strict=True)]
    for end, newtons in zip(ENDS, (0.5, 0.4, 0.625), strict=True):
        given = said[f"/palpate/force{end}"]
        assert [each[0] for each in given] == [1, RATE, 2 * RATE]
        for recorded, stamp, frame, force, torque in given:
            assert (stamp, frame, torque) == (recorded, "camera_optical_frame", zero)
            assert force == pytest.approx(-newtons * CONTACT.direction)  # F < 0 presses
    relative = said["/palpate/relative_force"]
    assert [each[0] // RATE for each in relative] == [*range(4, 13), 16, 17, 18, 21]
    assert {each[2] for each in relative[:9]} == {"camera_optical_frame"}
    assert np.array([each[3] for each in relative[:9]]) == pytest.approx(np.outer(np.ones(9), -CONTACT.direction))
    assert [each[2:] for each in relative[9:]] == [("palpate_pull", [x, 0, 0], zero) for x in (0.25, 1, 0.5, 0.5)]
    lows = [each[3][0] for each in said["/palpate/relative_force_low"]]
    assert lows == pytest.approx(np.array([0.25, 1, 0.5, 0.5]) - 1.6448536 * 0.1 / 2)


@pytest.mark.parametrize("kind", BAGS)
@pytest.mark.parametrize("given", ["given.bag", "given"])
def test_a_bag_keeps_its_clock_and_its_frame(tmp_path, kind, given) -> None:
    def recorded(make):
        yield from (("/image", make.compressed(index, np.zeros((48, 64, 3), np.uint8))) for index in (3, 4))
        yield "/tool/wrench", make.wrench(0, 3.0, -4.0, 0.5)

    source = open_source(write_given(tmp_path / given, recorded), ClipLayout())
    write_bag(kind, source, tmp_path, contacts(at(GOOD, 2)))
    said = read(tmp_path / BAGS[kind])
    assert said["/palpate/verdict"] == [(BEGIN + 5 * RATE, "determined")]
    instants = [BEGIN + index * RATE for index in range(14)]
    assert [each[:3] for each in said["/palpate/relative_force"]] == [(now, now, "camera") for now in instants[5:]]
    assert sorted(said) == ["/palpate/relative_force", "/palpate/verdict"]
    write_bag(kind, source, tmp_path, [])
    assert read(tmp_path / BAGS[kind]) == {}  # a clip without contact
