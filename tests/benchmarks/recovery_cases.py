"""Results of the benchmark whose scores are known in closed form."""

import numpy as np

from benchmarks.harness import Row
from benchmarks.recovery.suites import suite_clip_seed
from palpate.data.synthetic.truth import REGIMES

TRUTH = np.array([0.5, 0.05, -0.1])


def recovery(index: int = 0, **changes) -> Row:
    """A clip whose θ was estimated exactly, with bounds of 0.1.

    Information of log θ alone [3, 3] is taken to be that of a press whose delays have no part in it.
    """
    clip = {"suite": "clean", "index": index, "estimator": "direct", "seed": suite_clip_seed("test", 0, index)}
    truth = {"action": "press", "regime": REGIMES[index % 3], "status": "ok", "theta": TRUTH}
    told = {"field_information": np.eye(3) / 0.1**2, "noise": 0.001, "misfit": 1.0}
    found = {"estimate": TRUTH, "covariance": np.eye(3) * 0.01, "verdict": "determined", "seconds": 1.0}
    fields = clip | truth | told | found | changes
    if (told := fields["field_information"]) is not None:
        fields["field_information"] = np.pad(told, (0, 5 - len(told)))
    return {name: value for name, value in fields.items() if value is not None}


def off_by(errors: object) -> np.ndarray:
    """θ whose logarithms differ from the truth's by these, shape [3]."""
    return TRUTH * np.exp(np.asarray(errors, float))
