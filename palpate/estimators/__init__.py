"""From prepared frames to estimates of θ, or of a field of stiffness: four estimators behind one contract.

contract        Estimator and Session: opened once, a session a clip; open: an estimator by its name
result          base of results: quantities with intervals, fields that are columns of tables
estimate        θ with its uncertainty and verdict; records: of a frame and of a run of contact
network         a posterior for every frame; gan: the parameter network of the generator
direct          the simulator fitted to every run of contact
grip            relative force of pulls, by a sheet on a foundation
palpation       Young's modulus and Poisson's ratio from measured forces and deformed surfaces
online          stiffness place by place, of particles that are mapped to what every frame shows
run_tracker     runs of contact, frame by frame; runs: the part that all sessions share
onset           unknown beginnings of a press; oblique: presses aslant to the line of sight
known_force     a force measured in a part of a motion, as the scale of the rest
force_scale     newtons for scene units by a known force or stiffness; calibration_file: the file that says so
palpated        Young's modulus from what a palpation left
cloud_shape     the surface that a cloud shows, in sequences beside a robot
model_settings  an exported network's preparation, and what both networks' estimators share
session         runs a session over a clip: the one way in which frames become estimates
"""
