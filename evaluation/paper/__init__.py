"""What `train.py test` makes of its records: the paper's table 2 and figure 3, and what they leave out.

report      all files of an evaluation: tables, one HTML page, JSON
analysis    all numbers of an evaluation
statistics  means with intervals, paired tests
baselines   the simulator without a network: no motion, one constant θ
motion      when a simulated motion has come to rest, and whether it can be believed
collapse    whether the network gives the same θ whatever it sees
figures     the pictures
recovered   estimates beside the truth of synthetic clips
readings    what the paper leaves open, by simulation at its θ, without any training
"""

from physics.lazy import exported

__getattr__ = exported(
    {
        "evaluation.paper.report": ("write_evaluation",),
        "evaluation.paper.analysis": ("Evaluation", "EvaluationError", "analyse"),
    }
)
