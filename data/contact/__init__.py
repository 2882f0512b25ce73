"""Where tool and tissue touch, how the tissue moves there, and the Interaction that comes of it.

geometry       depth and labels to clouds, contact pair, mesh and normal; outlines: their doubtful rims
surface        smooth tissue behind noisy depth, and the noise; rest_depth: its shape before it was touched
evidence       whether tissue moves with the tool, frame by frame; coupling: likelihood ratio of its motion if it does
clearance      contact by the measured distance of an instrument's free end from the tissue under it
tips           free ends of instruments in a mask; light_contacts: presses by how the tissue's light changes
instruments    a number for each instrument, which it keeps
shaft          how long a scene unit is, by the known diameter of an instrument's shaft
lit_frame      where a frame's tissue has darkened, and where instruments are in it
motion         the contact's motion from frame to frame and since its onset
tissue_points  places in a picture as points in space; refinement: where a young contact presses
depth_sequence  depth around a contact from frame to frame
interaction    the frames of a run of contact as mesh, load and records of observations
features       an interaction as the vector that networks read; sequence_features: its depth-change sequence likewise
"""
