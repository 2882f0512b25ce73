"""The contact posterior: θ, its uncertainty and a verdict from the observation of a contact so far.

estimator    runs the exported network, a session a clip
misfit       how far the observation lies from the simulated motion
training     simulated contacts that train the network (models/contact_module.py), and what explains them
calibration  exports the network, or calibrates its standard deviations; a program of its own
fits         motions with the parameters that explain them, and noisy observations of them, for the fine stage
"""
