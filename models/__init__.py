"""The networks, their training step, and their exported form.

generator       encoder, either head (the posterior's with the picture added) and decoder; discriminator: the PatchGAN
carried_depth   the next depth map as the simulator alone predicts it, from which the decoder starts
posterior       θ of a contact with its covariance and expected bound; evidence: the losses of both
calibration     settings of standard deviations with the right coverage; calibration_fit: fits them
module          training of the GAN; step: what a training step computes, and its terms; losses: their formulas
contact_module  training of the contact posterior
records         one record a test pair; checkpoint: reading checkpoints
onnx_export     writes a trained network as one ONNX file, and calibrates such a file
onnx_session    runs an exported network, without torch
instruments/    the network that outlines instruments, and its training
weights/        the networks that ship with the program, and their model cards
"""
