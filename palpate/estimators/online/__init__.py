"""The online estimator (Liang 2024): a simulated state is taken to what was observed, and its stiffness to fit.

objective  the residual deformation that takes a state to what was observed (a cloud, followed points); gap, history and
           smoothness, with their slopes by the fields of stiffness, which have sigmoid bounds
session    one clip's state and field, frame by frame: PBD, PBD-RM, PBD-RM-ON; Adam
surface    particles of the tissue in a frame, and which the camera sees; driven: these under an instrument
determined what the instrument alone explains of the motion, by one number each (time step, foundation and bending) and
           place by place, by Gauss–Newton steps, and where that tells the stiffness; knots: numbers that make a field
forecast   skill of predicting later frames, by the field and by a sheet of one number
particle_field estimate of the field in a frame and over a run
sequence   tissue of a sequence beside a robot, with its clouds, followed points and a gripper's poses, in metres
estimator  a sheet or a volume for every run of contact; settings: as configs/online.yaml holds them
"""
