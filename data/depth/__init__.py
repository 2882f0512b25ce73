"""Depth of every pixel from the camera: one map a frame, in scene units.

sources      maps of stored files or of a network, and the constants that are frozen for a clip
normalise    the one normalisation to the clip's fixed scale, and the grid
model        any depth network as an ONNX file: input, session, meaning of its output
stereo       depth of a stereo pair: rectified, matched, in metres
preset       input and output conventions of a network, as YAML files in presets/
shading      the shape of tissue by its brightness, without texture
photometric  depth from brightness, without training
"""
