"""The network that outlines instruments, and its training.

network  U-Net of residual convolutions
module   loss, schedule, averaged weights, export
"""
