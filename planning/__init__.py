"""Paths of an instrument's tip that pay for the tissue they push aside (Frank 2010, section VII).

scene      the file that names tissue, obstacles, start and goal, and where straight lines meet them
press      what it takes to push the tip into a piece of tissue, simulated
cost_table such presses, cached for a piece of tissue and generalised by a kernel
roadmap    probabilistic road map and the cheapest way through it
pictures   the plan drawn
space      the file of a scene in space: a user's body, start, goal and port
surface    the body's surface and signed distances from it
pressing   forces and costs of an instrument in space
space_map  road map in space, kept in a file, and the cheapest way through it
sampled    the same by OMPL
waypoints  times, poses and expected forces of a way in space
"""
