"""Forces and verdicts of a clip as a bag of ROS that the library `rosbags` writes."""

import shutil
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from palpate.data.source.bags import WRENCHES
from palpate.data.source.frames import FrameSource
from palpate.estimators.result import ENDS
from palpate.results.artefacts.base import Artefact
from palpate.results.artefacts.forces import RELATIVE
from palpate.results.store import BAGS


class Ros2Bag(Artefact):
    """forces.mcap."""

    kind = "ros2"
    name = BAGS[kind]

    @classmethod
    def wanted(cls, options, estimator) -> bool:
        return options.bag == cls.kind

    def finish(self) -> None:
        write_bag(self.kind, self.clip.source, self.clip.partial, self.clip.report()["contacts"])


class Ros1Bag(Ros2Bag):
    """forces.bag."""

    kind = "ros1"
    name = BAGS[kind]


def write_bag(kind: str, source: FrameSource, folder: Path, contacts: Sequence[Mapping[str, Any]]) -> None:
    """Write a bag; where no force is known there is no message.

    Args:
        kind: of BAGS, which names the file.
        source: the clip, on whose clock the messages are.
        folder: where to write it.
        contacts: as forces.json has them.

    Raises:
        OSError: the file can't be written.
    """
    from rosbags import rosbag1, rosbag2
    from rosbags.typesys import Stores, get_typestore

    old, types, wrench_type = kind == "ros1", get_typestore(Stores.ROS2_HUMBLE).types, WRENCHES[0]
    store = get_typestore(Stores.ROS1_NOETIC if old else Stores.ROS2_HUMBLE)

    def wrench(stamp: int, frame_id: str, force: np.ndarray) -> Any:
        time = types["builtin_interfaces/msg/Time"](*divmod(stamp, 10**9))
        vectors = (types["geometry_msgs/msg/Vector3"](*each) for each in (force.tolist(), (0.0, 0.0, 0.0)))
        header = types["std_msgs/msg/Header"](time, frame_id)
        return types[wrench_type](header, types["geometry_msgs/msg/Wrench"](*vectors))

    def messages() -> Iterator[tuple[int, str, Any]]:
        for run in contacts:
            name = f"/palpate/{'relative_force' if run['unit'] == RELATIVE else 'force'}"
            along = run["direction"]
            frame_id, axis = ("palpate_pull", np.eye(3)[0]) if along is None else (source.frame_id, along)
            times = source.begin_ns + np.rint(np.array([run["onset_time_s"], *run["time_s"]]) * 1e9).astype(int)
            onset, *stamps = np.maximum(times, 1).tolist()  # 0 is no time to ROS
            yield onset, "/palpate/verdict", types["std_msgs/msg/String"](run["verdict"])
            for end in ENDS:
                known = ((at, force) for at, force in zip(stamps, run[f"force{end}"], strict=True) if force == force)
                yield from ((at, name + end, wrench(at, frame_id, force * axis)) for at, force in known)

    with TemporaryDirectory() as temporary:
        path, topics, mcap = Path(temporary, "forces"), {}, rosbag2.StoragePlugin.MCAP
        with rosbag1.Writer(path) if old else rosbag2.Writer(path, version=9, storage_plugin=mcap) as writer:
            for stamp, topic, message in sorted(messages(), key=lambda each: each[0]):
                if (name := message.__msgtype__) == wrench_type:
                    message.header.seq = 0  # of ROS 1, which messages of ROS 2 lack
                topics[topic] = topics.get(topic) or writer.add_connection(topic, name, typestore=store)
                content = store.serialize_ros1(message, name) if old else store.serialize_cdr(message, name)
                writer.write(topics[topic], stamp, content)
        # A bag of ROS 2 is a folder; the one file in it says all that the folder does.
        shutil.move(path / BAGS[kind] if path.is_dir() else path, folder / BAGS[kind])
