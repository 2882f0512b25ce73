"""The online estimator on four simulated pulls, as Liang 2024 judges it: Table II.

sequences  two sheets and two blocks that are pulled, by another integrator on another mesh
compare    one method on one pull, DiffCloud's among them: distances, future gaps, keypoints; and the table
__main__   the command `python -m benchmarks.online`
"""
