"""The online estimator on four simulated pulls, as Liang 2024 shows it: figures 5, 7, 8 and 9, and Table II.

sequences  two sheets and two blocks that are pulled, by another integrator on another mesh
batch_fit  DiffCloud's way: one field fitted to the first frames, many times over
compare    one method on one pull: distances, future gaps, keypoints, the fields found
figures    the paper's, drawn; a door: `python -m evaluation.online`
"""
