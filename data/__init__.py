"""From pixels to interactions: a clip's frames, their depth and masks, and the contacts in them.

source     frames of files and folders; how they are named; the camera
masks      tool and tissue; depth: their distance
shading    the tissue's light, and its changes
picture_network  ONNX networks for either: opened, fed and run
contact    contacts of both, the tissue's motion, and the Interaction that the simulator replays
tracks     tracks of hundreds of tissue points over a clip
clip       ClipStream, the one path from pictures to prepared frames; settings: its settings
gaps       frames that measure nothing, set aside
prepared   a prepared frame; labels: labels of pixels; windows: the network's input
cache      prepared clips on disk
synthetic  clips with known truth
training   samples, splits and batches
"""

import os

# OpenCV reads this limit (MOST_PIXELS of data.source.images) when it is first imported, which happens later.
os.environ.setdefault("OPENCV_IO_MAX_IMAGE_PIXELS", "33554432")
