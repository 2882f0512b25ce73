"""From pixels to interactions: a clip's frames, their depth and masks, and the contacts in them.

source     frames of files and folders; how they are named; the camera
masks      where tool and tissue are; depth: how far away they are
shading     the tissue's light, and how it changes
picture_network  ONNX networks for either: opened, fed and run
contact    where they touch, how the tissue moves, and the Interaction that the simulator replays
tracks     hundreds of tissue points followed over a clip
clip       ClipStream, the one path from pictures to prepared frames; settings: what decides it
gaps       frames that measure nothing, and the neighbours that measurements around them are
prepared   what a prepared frame holds; labels: what a pixel shows; windows: the network's input
cache      prepared clips on disk
synthetic  clips with known truth
training   samples, splits and batches
"""

import os

# OpenCV reads this limit (MOST_PIXELS of data.source.images) when it is first imported, which happens later.
os.environ.setdefault("OPENCV_IO_MAX_IMAGE_PIXELS", "33554432")
