"""The online estimator on four simulated pulls, as Liang 2024 shows it: figures 5, 7, 8 and 9, and Table II.

sequences  two sheets and two blocks that are pulled, by another integrator on another mesh
compare    one method on one pull, DiffCloud's among them: distances, future gaps, keypoints, the fields found
figures    the paper's, drawn; __main__: the door, `python -m evaluation.online`
"""
