"""Prepared clips as training material.

samples      pairs of frames with their windows, contacts and interactions
splits       training, validation and test, by video
batches      samples as torch batches; datamodule: the loaders that Lightning asks for
preparation  all clips of a data set, one after the other
cholecseg8k  prepares a data set and counts what of it can be trained on; `python -m data.cholecseg8k` is the door
"""
