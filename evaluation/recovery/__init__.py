"""How well θ is recovered on synthetic clips whose truth is known.

suites      the kinds of clips, and their seeds
estimators  how each rival is opened; constant: what the rival always says that ignores its input
evaluate    one clip by one estimator; store: finished clips, so that a run goes on where it stopped
slabs       clips whose truth are finite elements
grips       the same of clips whose tool grips tissue; grip_bound: what these could have told at best
followed    how well their points were followed
bounds      what a contact, and its whole dent, could have told at best
scores      errors, coverage and verdicts of many; details: a row a quantity
output      the tables and what is printed; figures: the pictures
"""

from physics.lazy import exported

__getattr__ = exported(
    {
        "evaluation.recovery.suites": ("SUITES", "Suite"),
        "evaluation.recovery.evaluate": ("Recovery", "evaluate_clip"),
        "evaluation.recovery.scores": ("Scores", "score_all"),
    }
)
