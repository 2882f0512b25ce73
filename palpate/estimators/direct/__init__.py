"""The simulator fitted to a run of contact, without a network.

estimator    the settings, the session, and the fit from start to verdict
motion       how vertices move under a press that began and ended at its time stamps, or near them
patch        the same under a press on a patch, in any direction, whose force rises and falls
problem      starts, optima and their evidence
contact_fit  from there to an estimate
shading_fit  the tissue's shading, from starts to an estimate
joint        several observations together
sampling     mean and covariance of the posterior by importance sampling
"""
