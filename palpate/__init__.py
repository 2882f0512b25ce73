"""Tissue stiffness, damping and tool force from ordinary laparoscopic video, without force sensors or labels.

    import palpate
    for run in palpate.estimate("clip.mp4"):
        print(run.onset_frame, run.verdict, run.estimate)

api        what a script calls: estimate, open_clip, open_estimator, calibrate, plan; outline_page: OutlinePage
cli        what a user types; __main__: the command `palpate`
common     files, settings, terminals; knows nothing of the field
physics    simulators and their derivatives: simulate (numpy), rollout (torch), Mechanics
data       from pixels to an Interaction: one run of contact, its mesh, load and observed motion
models     networks, losses, exported files
observations what is compared: point, depth, shading; one motion against several
estimators from an Interaction to a PressResult: network, gan, direct, online
planning   instrument paths; results: what is written

Research software. Not a medical device.
"""

from palpate.common.lazy import exported

__getattr__, __dir__, __all__ = exported(
    {
        "palpate.common.provenance": ("__version__",),
        "palpate.outline_page": ("OutlinePage",),
        "palpate.api": ("calibrate", "estimate", "open_clip", "plan"),
        "palpate.estimators.open": ("open_estimator",),
        "palpate.data.contact.interaction": ("Interaction",),
        "palpate.estimators.estimate": ("PressResult",),
        "palpate.estimators.records": ("InteractionEstimate",),
        "palpate.physics.mechanics": ("Mechanics",),
        "palpate.physics.msd.rollouts": ("rollout",),
        "palpate.physics.msd.simulation": ("simulate",),
    }
)
