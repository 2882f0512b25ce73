"""Standard deviations of the models of pulls, in addition to what residuals tell, measured on synthetic clips.

They are of natural logarithms where nothing else is said (docs/reports/real.md).
"""

from types import SimpleNamespace

MODEL_ERRORS = SimpleNamespace(
    foundation_measured=0.005,  # foundation, by points that are measured again
    foundation_followed=0.015,  # the same by points as they are tracked
    foundation_uneven=0.43,  # foundation where residuals are correlated over many points
    force_uneven=0.68,  # force over stiffness, there
    foundation_as_seen=0.9,  # foundation where the grip's motion is that of points next to the instrument
    force_as_seen=0.68,  # force over stiffness, there
    force_common=0.85,  # correlation between errors of the force in two frames
    hidden_force=0.1,  # share of the force on the foundation of tissue that isn't visible
    strained_motion=0.03,  # share of tracked points' motion: windows are strained with the tissue
    sheet_excess=0.03,  # largest error of points besides their noise, by axis, on a homogeneous sheet [px]
    sheet_together=2.0,  # correlated residuals, in multiples of the points that tracking correlates
    followed_reach=6.2,  # reach of the correlation between tracked points' errors (Matérn 3/2) [px]
    measured_reach=5.0,  # the same of points that are measured again
    stiffness_roughness=0.55,  # difference of log stiffness between neighbouring knots, before any observation
    stiffness_together=24.0,  # number of correlated points where stiffness is mapped
    stiffness_unexplained=2.0,  # its factor where a sheet leaves more than sheet_excess
)
