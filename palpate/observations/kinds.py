"""Observations by name."""

from palpate.common.registry import Registry

OBSERVATIONS = Registry(
    "observation",
    "palpate.observations",
    {
        "depth": "palpate.observations.depth:DepthObservation",
        "shading": "palpate.observations.shading:ShadingObservation",
    },
)
"""Kinds of `Observation`."""
