"""The networks, their training step, and their exported form.

generator       encoder, parameter head and decoder; discriminator: the PatchGAN
carried_depth   what physics alone makes of the next picture, for the decoder to start from
posterior       θ of a contact with its covariance, and how well it can be known; contact_head: beside the picture
expected_bound  the loss of what can be known; calibration: standard deviations that hold;
                calibration_fit: which these are
module          the training step; losses: its five terms; evidence: the physics term of a posterior
augmentation    disturbed windows; records: what a test writes down; checkpoint: reading checkpoints
onnx_export     a trained network as one ONNX file; onnx_calibration: one whose standard deviations hold
onnx_session    running it, without torch
weights/        the network that comes along, and its card
"""

from physics.lazy import exported

__getattr__ = exported(
    {
        "models.generator": ("Generator",),
        "models.discriminator": ("PatchDiscriminator",),
        "models.posterior": ("ContactPosterior",),
        "models.module": ("PhysicsInformedGAN",),
        "models.losses": ("LossWeights",),
        "models.calibration": ("Calibration",),
        "models.onnx_export": ("export",),
        "models.onnx_session": ("ModelFileError", "ParameterModel", "PosteriorModel", "open_model"),
    }
)
