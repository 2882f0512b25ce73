"""Synthetic clips with known truth, observed with errors as real ones have.

settings  all settings of a scene; clip: a clip from seed to frames, in memory or as files
scene     the tissue sheet, the organ's outline, the tool's entry; truth: θ, the force and the true motion of a press
integration  its equations of motion solved
grip      tissue that the tool holds and moves, or only passes over
passage   the tool of a view that tissue fills: its way in space, and its shadow
surface   depth of the deformed sheet in every pixel; tool: the grasper; render: the pictures
turning   a camera that turns
errors    noise, rounding and wrong outlines; files: how a clip is stored
source    a clip in memory as a FrameSource; contacts: motions without pictures, many and cheap

`python -m data.synthetic` writes clips.
"""
