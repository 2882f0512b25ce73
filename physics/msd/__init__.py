"""Mass–spring–damper sheets (Bini 2026, section 3.3): one set of equations, written three times for three purposes.

reference     the equations in plain numpy: read this one
simulation    the numpy door: simulate, simulate_sensitivities, simulate_field, simulate_reaction
rollouts      the torch door: rollout, rollout_sensitivities, rollout_field, rollout_heterogeneous; batch: what it takes
likelihoods   the paper's squared error of a batch, and its likelihood
compiled      one sample through the kernels: grid_kernel on grid_layout, edge_kernel on spring_graph; cone: which part
autograd      torch's view of the compiled rollout; torch_backend: every derivative, any device
"""

from physics.lazy import exported

__getattr__ = exported(
    {
        "physics.msd.rollouts": ("rollout", "rollout_field", "rollout_heterogeneous", "rollout_sensitivities"),
        "physics.msd.simulation": ("simulate", "simulate_field", "simulate_reaction", "simulate_sensitivities"),
        "physics.msd.batch": ("DepthBatch", "GripBatch", "MeshBatch", "ObservationBatch", "PressBatch"),
    }
)
