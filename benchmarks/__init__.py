"""What is timed or measured once, against what; each is run by `python -m benchmarks.NAME`.

rollout             the differentiable rollout against plain torch
inference           where the time of inference goes: encoder and head alone, and every stage of infer.py
fem                 a body at rest, its tangents and its adjoint against element count, beside scikit-fem
training_step       where the time of a training step goes
physics_plots       the pictures of docs/reports/physics.md
newtons             forces of synthetic clips in newtons, of which the force of one is known
observation_bounds  what each kind of observation can tell about θ
following           following tissue points: time a frame, and error where the motion is known
planning            the planner: costs from its table against simulated ones, a query against simulating its lines
online              what a step of the online estimator costs, beside the paper's, and by particles
tracking_errors     errors of tracked contacts, for the direct estimator's error model
automatic_masks     automatic masks against annotation
photometric_depth   photometric depth against stereo depth and truth
shared              what all of them need: command line, timing, a table, the machine
"""
