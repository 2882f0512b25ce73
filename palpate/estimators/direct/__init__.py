"""The simulator fitted to a run of contact, without a network.

estimator    the settings, the session, and the fit from start to verdict
motion       how vertices move under a press that began and ended at its time stamps, or near them
patch        the same under a press on a patch, in any direction, whose force rises and falls
problem      starts, optima and their evidence; field: a depth-change sequence by least squares
contact_fit  from there to an estimate
lit_sheet    what a camera with a light next to it sees of a pressed plane
shading      the tissue's shading by least squares; shading_fit: from there to an estimate
sampling     mean and covariance of the posterior by importance sampling
"""
