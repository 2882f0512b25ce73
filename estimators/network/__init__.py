"""The contact posterior: θ, its uncertainty and a verdict from what was seen of a contact so far.

estimator  the exported network at work, a session a clip
misfit     how far what was seen lies from the simulated motion
training   trains it without labels; `python -m estimators.network.training` is the door
calibration  exports it, or makes its standard deviations hold; a door of its own
fits       observed motions with what explains them; draws: as they might have been observed, for the fine stage
"""
