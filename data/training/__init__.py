"""Prepared clips as training material.

samples      pairs of frames with their windows, contacts and interactions
splits       training, validation and test, by video
batches      samples as torch batches; datamodule: the loaders that Lightning asks for
preparation  the clips of a data set, prepared one after the other
contacts     simulated contacts for the contact posterior, a stage an epoch
instruments/ pictures of instruments with their outlines, drawn and real
"""
