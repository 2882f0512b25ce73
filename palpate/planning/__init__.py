"""Paths of an instrument's tip that pay for the tissue they push aside (Frank 2010, section VII).

scene      the file that names start, goal and tissue, in a plane or in space; where lines of a plane meet tissue
press      what it takes to push the tip into a piece of tissue, simulated
cost_table such presses, cached for a piece of tissue and generalised by a kernel
roadmap    probabilistic road map and the cheapest way through it
pictures   the plan drawn
surface    the body's surface and signed distances from it
pressing   forces and costs of an instrument in space
space_map  road map in space, kept in a file, and the cheapest way through it
waypoints  times, poses and expected forces of a way in space
"""
