"""Files written for a clip, a class a file.

base       Artefact, and the registry: built-ins, and entry points of the group `palpate.artefacts`
tables     parameters.csv, interactions.csv, calibrated.csv; forces: forces.json; results: results.json
overlay    overlay.mp4; fit: fit.png
fields     fields.npz; export: .vtu files; bag: forces for ROS
"""
