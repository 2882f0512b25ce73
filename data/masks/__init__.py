"""Where tool and tissue are in a frame: label maps from annotation, a network, outlines, or none of these.

sources           the common interface MaskSource, annotation masks, and the choice between the kinds
onnx              any segmentation network as an ONNX file
outlined          instruments that a person has outlined in a frame, followed from there
rigid             an instrument followed from an outline on, for both
automatic         raw video without a network: an instrument by its shape, other lit pixels as tissue
instrument_bands  the straight edges of a shaft, for automatic
class_table       CholecSeg8k's classes and colours
"""
