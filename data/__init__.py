"""From pixels to interactions: a clip's frames, their depth and masks, and the contacts in them.

source     frames of files and folders; how they are named; the camera
masks      where tool and tissue are; depth: how far away they are
picture_network  ONNX networks for either: opened, fed and run
contact    where they touch, how the tissue moves, and the Interaction that the simulator replays
tracks     hundreds of tissue points followed over a clip
clip       ClipStream, the one path from pictures to prepared frames; settings: what decides it
prepared   what a prepared frame holds; labels: what a pixel shows; windows: the network's input
cache      prepared clips on disk
command_line  what the programs' command lines share: types of options, sentences, bars
synthetic  clips with known truth
training   samples, splits and batches; cholecseg8k: the door that prepares a data set
"""

import os

from physics.lazy import exported

__getattr__ = exported(
    {
        "data.clip": ("ClipStream", "prepare"),
        "data.settings": ("PrepareSettings",),
        "data.prepared": ("PreparedFrame",),
        "data.cache": ("PreparedClip",),
        "data.source.frames": ("discover", "open_source"),
        "data.source.layout": ("ClipLayout", "InputError"),
        "data.depth.normalise": ("DepthSettings",),
        "data.contact.geometry": ("GeometrySettings", "find_contact"),
        "data.contact.interaction": ("Interaction",),
    }
)
# OpenCV reads this limit (MOST_PIXELS of data.source.images) when it is first imported, which happens later.
os.environ.setdefault("OPENCV_IO_MAX_IMAGE_PIXELS", "33554432")
