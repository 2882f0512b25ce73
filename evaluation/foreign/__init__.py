"""Answers of the finite elements on other people's data, simulated and real.

liver        a pulled liver of a foreign simulation: force, and Young's modulus, from points of its surface
surface_fit  the force that pulls a body into the shape of its points
beam         a silicone beam that rings: Young's modulus, and the motion with another mass at its tip
__main__     the door
"""
