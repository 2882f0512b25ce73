"""Contacts of tool and tissue, the tissue's motion there, and the Interaction made of both.

geometry       depth and labels to clouds, contact pair, mesh and normal; outlines: their doubtful rims
surface        smooth tissue behind noisy depth, and the noise; rest_depth: its shape before it was touched
evidence       probability that tissue moves with the tool, by frame; coupling: likelihood ratio of that motion
clearance      contact by the measured distance of an instrument's free end from the tissue under it
tips           free ends of instruments in a mask; light_contacts: presses by changes of the tissue's light
instruments    a number for each instrument, which it keeps
shaft          length of a scene unit, by the known diameter of an instrument's shaft
lit_frame      darkened tissue of a frame, and the instruments in it
motion         the contact's motion from frame to frame and since its onset
tissue_points  places in a picture as points in space; refinement: place of a young contact
depth_sequence  depth around a contact from frame to frame
interaction    the frames of a contact as mesh, load and records of observations
features       an interaction as the vector that networks read; sequence_features: its depth-change sequence likewise
"""
