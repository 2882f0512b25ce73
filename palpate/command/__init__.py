"""What a user types: `palpate infer`, `train`, `calibrate` and `plan`; in a checkout `python infer.py` and so on.

infer      video → estimates
train      fit, validate, test or export the parameter network, from one configuration file
tracking   the MLflow run of a training
calibrate  measured forces → material constants
plan       an instrument's path past tissue that gives way
"""
