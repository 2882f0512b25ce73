"""Mass–spring–damper sheets (Bini 2026, section 3.3): the same equations in numpy and in compiled loops.

reference     the equations in plain numpy: read this one
simulation    for numpy: simulate, simulate_sensitivities; one sample through the kernels
rollouts      for torch: rollout, rollout_sensitivities; batch: observations
likelihoods   the paper's squared error of a batch
grid_kernel   the compiled loops, on a pixel grid; grid_layout: the mesh on it; cone: which part of it matters
autograd      torch's view of the compiled rollout
"""

from palpate.common.lazy import exported

__getattr__, __dir__, __all__ = exported(
    {
        "palpate.physics.msd.rollouts": ("rollout", "rollout_sensitivities"),
        "palpate.physics.msd.simulation": ("simulate", "simulate_sensitivities"),
        "palpate.physics.msd.batch": ("ObservationBatch",),
    }
)
