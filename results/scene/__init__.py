"""What was estimated as a scene to simulate further (--export): for USD, SOFA, VTK and PLY, and read again.

scene    a scene's parts, whatever made it; kinds.yaml has their names and units, formats.yaml the files' texts
kinds    the scene of a run of contact, and what each kind's simulator makes of a scene
files    scenes written and read
"""
