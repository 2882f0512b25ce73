"""Where tool and tissue are in a frame: label maps from annotation, a network, or neither.

sources           the common face MaskSource, annotation, and the choice between them
onnx              any segmentation network as an ONNX file
automatic         raw video without a network: an instrument by its shape, the lit rest as tissue
instrument_bands  the straight edges of a shaft, for automatic
class_table       CholecSeg8k's classes and colours
"""

from physics.lazy import exported

__getattr__ = exported(
    {
        "data.masks.sources": ("MaskClasses", "MaskError", "MaskSource", "open_masks", "read_mask"),
        "data.masks.onnx": ("OnnxMasks", "SegmentationSettings"),
        "data.masks.automatic": ("AutomaticMasks",),
        "data.masks.class_table": ("CLASSES",),
    }
)
