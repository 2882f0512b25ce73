"""Bags that the library `rosbags` writes itself, of given messages."""

from collections import Counter
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from rosbags.rosbag1 import Writer as Writer1
from rosbags.rosbag2 import StoragePlugin
from rosbags.rosbag2 import Writer as Writer2
from rosbags.typesys import Stores, get_typestore

BEGIN = 1_700_000_000_123_456_789
"""Time stamp of the first message [ns]."""
RATE = 40_000_000
"""From one message to the next [ns]."""


class Messages:
    """Makes messages of ROS 1 or 2, whose headers are stamped by an index; without one they have no time stamp."""

    def __init__(self, *, old: bool) -> None:
        self.old, self.store = old, get_typestore(Stores.ROS1_NOETIC if old else Stores.ROS2_HUMBLE)

    def message(self, kind: str, index: int | None, **fields: Any) -> Any:
        stamp, types = 0 if index is None else BEGIN + index * RATE, self.store.types
        time = types["builtin_interfaces/msg/Time"](stamp // 10**9, stamp % 10**9)
        sequence = {"seq": 0} if self.old else {}
        return types[kind](header=types["std_msgs/msg/Header"](**sequence, stamp=time, frame_id="camera"), **fields)

    def image(self, index: int | None, pixels: np.ndarray, encoding: str = "rgb8", padding: int = 0, **other) -> Any:
        """A picture as it is, its rows padded with something else; `other` fields are changed."""
        rows = np.pad(pixels.reshape(len(pixels), -1), ((0, 0), (0, padding)), constant_values=77)
        fields = {"height": len(pixels), "width": pixels.shape[1], "encoding": encoding, "step": rows.shape[1]}
        fields |= {"is_bigendian": 0, "data": rows.ravel()} | other
        return self.message("sensor_msgs/msg/Image", index, **fields)

    def compressed(self, index: int, picture: np.ndarray) -> Any:
        """An RGB picture as PNG, which loses nothing."""
        data = cv2.imencode(".png", picture[..., ::-1])[1].ravel()
        return self.message("sensor_msgs/msg/CompressedImage", index, format="rgb8; png compressed bgr8", data=data)

    def wrench(self, index: int, *force: float) -> Any:
        vectors = [self.store.types["geometry_msgs/msg/Vector3"](*values) for values in (force, (0.0, 0.0, 9.0))]
        wrench = self.store.types["geometry_msgs/msg/Wrench"](*vectors)
        return self.message("geometry_msgs/msg/WrenchStamped", index, wrench=wrench)

    def camera(self, matrix: Any, bent: Any, focal: float, model: str = "plumb_bob") -> Any:
        """A camera of 128x96; `focal` is that of pictures without distortion."""
        projection = np.array([focal, 0, 64, 0, 0, focal, 48, 0, 0, 0, 1, 0], float)
        fields = {"k": np.array(matrix, float), "d": np.array(bent, float), "r": np.eye(3).ravel(), "p": projection}
        if self.old:
            fields = {name.upper(): value for name, value in fields.items()}
        fields["roi"] = self.store.types["sensor_msgs/msg/RegionOfInterest"](0, 0, 0, 0, False)
        size = {"height": 96, "width": 128, "binning_x": 0, "binning_y": 0, "distortion_model": model}
        return self.message("sensor_msgs/msg/CameraInfo", 0, **fields, **size)


def write_bag(path: Path, recorded: Callable[[Messages], Iterable[tuple[str, Any]]]) -> Path:
    """Write a bag: of ROS 1 where the path ends in .bag, else a folder of ROS 2, of SQLite where it ends in _db3.

    Args:
        path: the file or the folder.
        recorded: gives topics with their messages, recorded RATE apart on each; bytes stand for a damaged one.
    """
    make, counts, connections = Messages(old=path.suffix == ".bag"), Counter(), {}
    plugin = StoragePlugin.SQLITE3 if path.name.endswith("_db3") else StoragePlugin.MCAP
    serialize = make.store.serialize_ros1 if make.old else make.store.serialize_cdr
    with Writer1(path) if make.old else Writer2(path, version=9, storage_plugin=plugin) as writer:
        for topic, message in recorded(make):
            if topic not in connections:
                connections[topic] = writer.add_connection(topic, message.__msgtype__, typestore=make.store)
            content = message if isinstance(message, bytes) else serialize(message, message.__msgtype__)
            writer.write(connections[topic], BEGIN + 5_000_000 + counts[topic] * RATE, content)
            counts[topic] += 1
    return path
