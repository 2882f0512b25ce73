"""Commands: `palpate infer`, `live`, `train`, `calibrate`, `plan`, `page`; in a checkout `infer.py` …

infer        video → estimates
live         camera, stream or pipe → a line of JSON a frame
train        fit, validate, test or export a network, from one configuration file
tracking     the MLflow run of a training
calibrate    measured forces → material constants
page         results → pages for a browser
outline      strokes on instruments → outlines that `--masks` reads
plan         an instrument's path past tissue that gives way
"""
