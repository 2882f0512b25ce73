"""Label maps of a frame, tool and tissue: from annotation, a network, outlines, or none of these.

sources      the choice between the kinds of masks; request: what they are asked for and give
annotation   masks stored with a clip's frames; folder: in a folder of their own
onnx         any segmentation network as an ONNX file
outlined     instruments that a person has outlined in a frame, followed from there
cut          an instrument cut out by strokes
outlining    a session in which a person outlines instruments
rigid        an instrument followed from an outline on
automatic    raw video: instruments by the network that ships, other lit pixels as tissue
lit          the lit part of a picture: the endoscope's view
class_table  CholecSeg8k's classes and colours
"""
