"""The simulator fitted to a run of contact, without a network.

estimator    the settings, the session, and the fit from start to verdict
problem      one contact by least squares from several starts; delayed: with unknown beginning and end of the press
sampling     mean and covariance of the posterior by importance sampling
error_model  how errors of a tracked contact belong together
"""
