"""The networks, their training step, and their exported form.

generator       encoder, parameter head and decoder; discriminator: the PatchGAN
carried_depth   the next depth map as the simulator alone predicts it, from which the decoder starts
posterior       θ of a contact with its covariance and expected bound; contact_head: the same with the picture added
expected_bound  the loss of the expected bound
calibration     settings of standard deviations with the right coverage; calibration_fit: fits them
module          the training step; losses: its five terms; evidence: the physics term of a posterior
augmentation    sensor noise on windows; records: one record a test pair; checkpoint: reading checkpoints
onnx_export     writes a trained network as one ONNX file, and calibrates such a file
onnx_session    runs an exported network, without torch
weights/        the networks that ship with the program, and their model cards
"""

from palpate.common.lazy import exported

__getattr__ = exported(__name__, {})
