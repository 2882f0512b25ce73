"""Settings of a synthetic scene: its geometry, tissue and time course, and the errors with which it is observed.

The same settings and the same seed give the same clip. Lengths are scene units (the tissue lies at z of about 0.5),
times seconds.
"""

import math
from dataclasses import dataclass
from typing import Annotated, Literal

from palpate.common.settings import Checked
from palpate.data.source.camera import MOST_SIDE
from palpate.data.source.layout import FRAME_RATES

Range = tuple[float, float]


@dataclass(frozen=True)
class SceneSettings(Checked, group="scene."):
    """Parameters drawn, geometry, time course, and errors of observation of a synthetic clip.

    Numbers are annotated with the least and the largest that they, or both ends of a range, may be.
    """

    width: Annotated[int, 64, MOST_SIDE] = 854
    """Picture width [px]."""
    height: Annotated[int, 48, MOST_SIDE] = 480
    """Picture height [px]."""
    frames: Annotated[int, 8, 1e6] = 40
    """Frames of a clip."""
    fps: Annotated[float, *FRAME_RATES] = 25.0
    """Frames a second."""
    grid_width: Annotated[int, 64, MOST_SIDE] = 214
    """Columns of the true mesh's grid, the network's input width."""
    grid_height: Annotated[int, 48, MOST_SIDE] = 120
    """Rows of the true mesh's grid, the network's input height."""
    view: Literal["island", "filled"] = "island"
    """Content of the picture: an organ that the tool leaves along the picture's plane while it doesn't touch (island);
    or organs that fill it as in a real view, with the tool in front of them in every frame."""
    masked: Literal["organ", "all"] = "organ"
    """Tissue that stored masks call gallbladder and that the true mesh covers: the target organ, or all tissue."""
    field_of_view_deg: Annotated[float, 20, 110] = 60.0
    """Horizontal field of view [degrees]."""
    stiffness: Annotated[Range, 1e-6, 1e9] = (0.2, 1.0)
    """k_s is drawn log-uniformly from this range [normalised]."""
    damping: Annotated[Range, 1e-9, 1e9] = (0.01, 0.3)
    """k_d is drawn log-uniformly from this range [normalised]."""
    force: Annotated[Range, -1e9, -1e-9] = (-0.3, -0.03)
    """Signed F, its magnitude drawn log-uniformly [normalised]; negative presses into the tissue."""
    regime: Literal["any", "under-damped", "critical", "over-damped"] = "any"
    """Keep only draws with ζ = k_d/(2√(k_s m)) under 0.7, from 0.7 to 1.4, or over 1.4."""
    mass: Annotated[float, 1e-12, 1e12] = 0.001
    """Mass of every vertex [kg by the paper's convention]."""
    peak_displacement: Annotated[Range, 0, 10] = (0.01, 0.06)
    """Keep only draws whose largest displacement of the contact vertex lies in this range [scene units]."""
    action: Literal["press", "grip", "slide", "hover", "pass"] = "press"
    """Action of the tool. press: press with a force. grip: hold tissue to the clip's last frame and move it across the
    line of sight, by peak_displacement (force and regime have no effect). In a filled view also slide: press while the
    tip slides over the tissue; hover: stop in front of the tissue; pass: pass in front of it, both without contact."""
    travel: Annotated[Range, 0, 200] = (6.0, 20.0)
    """Distance that the tip of a tool slides or passes, drawn uniformly [grid px]."""
    hover_height: Annotated[Range, 0.002, 0.1] = (0.008, 0.05)
    """Least distance along the line of sight between the tissue and the tip of a tool that hovers or passes, drawn
    log-uniformly [scene units]."""
    elevation_deg: Annotated[Range, 35, 70] = (40.0, 60.0)
    """Angle between the tool's axis and the plane across the line of sight in a filled view, drawn uniformly."""
    spread: Annotated[Range, 2, 1000] = (12.0, 30.0)
    """Distance over which the motion of a grip dies away, √(3·stiffness/foundation), drawn log-uniformly [grid px]."""
    relaxation: Annotated[Range, 1e-4, 10] = (0.002, 0.01)
    """Damping over foundation of gripped tissue, drawn log-uniformly [s]."""
    regions: Annotated[float, 1, 100] = 1.0
    """Stiffness of gripped tissue on one side of a line near the grip, divided by that on the other."""
    patch_radius: Annotated[Range, 0, 20] = (0.0, 0.0)
    """A press acts on the vertices nearer than this, as 1 - (r/R)², R drawn uniformly [grid px]; 0 = on the contact
    vertex alone."""
    force_tilt_deg: Annotated[Range, 0, 60] = (0.0, 0.0)
    """Angle between the force of a press and the normal of the tissue, drawn uniformly, to any side [degrees]."""
    profile: Literal["step", "ramp", "hold"] = "step"
    """Force while in contact: constant, rising linearly from 0 to F at release, or rising, holding and falling."""
    rise: Annotated[Range, 0, 1] = (1 / 3, 1 / 3)
    """Share of the time in contact over which a force that holds rises, drawn uniformly."""
    fall: Annotated[Range, 0, 1] = (1 / 3, 1 / 3)
    """Share of the time in contact over which it falls, drawn uniformly; rise and fall sum to at most 1."""
    press_seconds: Annotated[Range, 1e-6, 1e4] = (0.25, 0.5)
    """Time in contact [s], rounded to whole frames."""
    onset_fraction: Annotated[Range, 0, 1] = (0.15, 0.25)
    """First frame in contact, as a share of the clip's frames. A tool that grips passes over the tissue before, and
    never touches it at 1."""
    onset_delay: Annotated[Range, 0, 1] = (0.0, 0.0)
    """Share of a frame interval by which the force starts after the time stamp of the first frame in contact; drawn
    uniformly from this range. A real press, too, starts between two frames."""
    release_delay: Annotated[Range, 0, 1] = (0.0, 0.0)
    """Share of a frame interval by which the force ends after the time stamp of the first frame after contact."""
    distance: Annotated[Range, 0.3, 0.8] = (0.45, 0.6)
    """Depth z of the contact [scene units]."""
    max_tilt_deg: Annotated[float, 0, 45] = 0.2
    """Largest angle between the contact normal and the line of sight [degrees]."""
    curvature: Annotated[Range, 0, 1.5] = (0.4, 1.1)
    """Curvature of the surface around its contact: z grows by half of this times the squared slope of the ray."""
    relief: Annotated[float, 0, 0.05] = 0.012
    """Amplitude of the tissue's random low-frequency waves, as a share of the depth."""
    stiffness_variation: Annotated[float, 0, 2] = 0.0
    """Standard deviation of log k_s over a smooth field of the springs; the fitted model is homogeneous."""
    nonlinearity: Annotated[float, 0, 10] = 0.0
    """β of the spring law k_s·e·(1 + β(e/0.01)²), e the elongation [scene units]: stiffening springs, 0 is linear."""
    depth_noise: Annotated[float, 0, 0.2] = 0.0
    """Standard deviation of the depth noise of a pixel [scene units]."""
    depth_noise_correlation: Annotated[float, 0, 100] = 0.0
    """Standard deviation of the blur of the depth noise [px], which keeps the noise's size; 0 is white noise."""
    depth_bias: Annotated[float, 0, 0.5] = 0.0
    """Standard deviation of log of a smooth factor on the depth that stays through the clip, as the error of monocular
    depth networks does."""
    depth_bits: Literal[8, 16] = 16
    """Bits of the stored depth; 8 rounds to 1/255 scene units."""
    scale_flicker: Annotated[float, 0, 0.5] = 0.0
    """Standard deviation of log of the factor on each frame's depth."""
    mask_error: Annotated[float, 0, 20] = 0.0
    """Standard deviation of the masks' outlines along each axis [grid px], new in each frame."""
    focal_error: Annotated[float, 0.2, 5] = 1.0
    """Reported focal length divided by the true one."""
    occlusion: Annotated[float, 0, 0.8] = 0.0
    """Share of the tissue hidden by a drifting piece of fat."""
    image_noise: Annotated[float, 0, 0.5] = 0.008
    """Standard deviation of the picture's noise, as a share of full scale."""
    highlights: Annotated[float, 0, 5] = 0.5
    """Brightness of the highlights on wet tissue at 0.5 scene units, as a share of full scale."""
    gloss: Annotated[float, 1, 1e5] = 1500.0
    """Phong exponent of the highlights: 1500 mirrors the light within about 2 degrees, 30 within 15."""
    lamp_offset: Annotated[float, 0, 0.2] = 0.0
    """Distance of two lamps from the lens [scene units]; 0 is one lamp at the lens, which casts no visible shadow."""
    vignetting: Annotated[float, 0, 1] = 0.0
    """Share of the light that is missing in the picture's corners; grows with the squared distance from the centre."""
    tool_in_view: bool = True
    """Draw the tool; otherwise what presses or grips is invisible, such as a probe from behind or a jet of air."""
    turning_deg: Annotated[float, 0, 10] = 0.0
    """Angle by which the camera turns to and fro about its lens within a second or two [degrees]; true places are those
    of the first frame's camera."""
    video_quality: Annotated[int, 0, 51] = 18
    """Constant rate factor of the video file (H.264): 18 hardly differs from the pictures, 23 usual, 28 poor."""

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.width < self.grid_width or self.height < self.grid_height:
            raise ValueError(f"scene.width and height {self.width}x{self.height} are below the grid's; give more.")
        if self.view == "island" and (self.action in ("slide", "hover", "pass") or self.masked == "all"):
            raise ValueError(
                f"scene.action {self.action}, masked {self.masked} isn't an island; give scene.view filled."
            )
        if self.rise[1] + self.fall[1] > 1:
            raise ValueError(f"scene.rise {self.rise[1]:g} and fall {self.fall[1]:g} add up to more than 1; give less.")
        rates = {"stiffness": math.sqrt(self.stiffness[1] / self.mass), "damping": self.damping[1] / self.mass}
        for name, fastest in rates.items():
            if fastest > 1e4:  # thirty times the defaults' rate; it decides how short the integrator's steps are
                raise ValueError(
                    f"scene.{name} up to {getattr(self, name)[1]:g} with scene.mass {self.mass:g} moves at "
                    f"{fastest:.3g}/s; give less, or more mass, for 10000/s at most."
                )

    @property
    def cell(self) -> tuple[float, float]:
        """Size of a grid cell along u and v [px]."""
        return self.width / self.grid_width, self.height / self.grid_height
