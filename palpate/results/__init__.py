"""Files that infer.py writes for a clip.

run       a batch of clips: finding them, going on after a failure; outcome: how they went, the closing tables
options   what a user chooses, beside preparation and the estimator's options
video     a video in a batch; sequence: a sequence beside a robot, particles in its frame
writer    one clip's folder, complete or not there; store: whose folder is whose, what is up to date
artefacts a class a file: tables, overlay, pictures, exports
spool     frames that wait for their contact's end; agreement: no surer than their contact says then
alarm     whether the force has reached a limit (--force-limit)
calibrated  a clip in newtons (--force-scale)
record    run.json: hashes, versions, settings, warnings
verdicts  what verdicts and statuses mean, what to do, their colours
overlay   a frame with what was found drawn on it
page      the same in a browser
paper     tables and figures of `train.py test`
"""
