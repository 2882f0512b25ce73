"""Frames with time stamps, their sources, and the camera that took them.

frames  video files, folders of images and bags as FrameSource; discovery: the search for them
decoding  the track of a video file, its time stamps and pictures; interlace: whether it is interlaced, deinterlacing
repeats pictures that repeat the one before
live    the same as they come from a camera, a stream or a pipe
layout  how a folder's frames, masks, depth and camera file are named
sequence  clouds or depth with a tool's poses, as sequence.yaml names them; sequence_checks: whether these fit together;
        clouds: files of points
bags    what bags of ROS hold: pictures, their camera, forces
lerobot names of the videos in LeRobot data sets
camera  intrinsics, back-projection, removal of lens distortion; camera_formats: files of OpenCV, ROS, SCARED
images  image files by their bytes, and paths as text; table: columns of numbers; video: a video file to write
"""
