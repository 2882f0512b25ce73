"""What infer.py writes for a clip.

run       a batch of clips: finding them, going on after a failure; outcome: how they went, the closing table
options   what a user chooses, beside preparation and the estimator's options
writer    one clip's folder, complete or not there; store: whose folder is whose, what is up to date
columns   the columns of all tables, whose texts are columns.yaml, and their rows
calibrated  a clip in newtons (--force-scale)
forces    of every run of contact: mean, peak, what is unknown (forces.json)
paper     tables and figures of `train.py test`
page      the same in a browser
alarm     whether the force has reached a limit (--force-limit)
bag       forces and verdicts for ROS (--bag)
vtu       deformation of a contact for ParaView and SOFA (--export)
sequence  of a sequence beside a robot: particles in its frame
agreement  frames' records, no surer than their contact says when it has ended
record    run.json: hashes, versions, settings, warnings
verdicts  what is said first, and no number surer than it is
plots     fit.png
overlay   the video; field_overlay: stiffness on it; spool: frames that wait for their contact's end
field_file  stiffness in fields.npz
"""
