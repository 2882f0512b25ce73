"""The simulator fitted to a run of contact, without a network.

estimator    the settings, the session, and the fit from start to verdict
problem      one contact's likelihood and where to start; delayed: with unknown beginning and end of the press
optima       least squares from several starts, and what the optima weigh
sampling     mean and covariance of the posterior by importance sampling
error_model  how errors of a tracked contact belong together
"""

from physics.lazy import exported

__getattr__ = exported(
    {
        "estimators.direct.estimator": ("DirectEstimator", "DirectSession"),
        "estimators.direct.problem": ("ContactProblem",),
        "estimators.direct.delayed": ("DelayedProblem",),
        "estimators.direct.sampling": ("sample_posterior",),
    }
)
