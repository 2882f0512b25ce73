"""What `train.py test` makes of its records: the paper's table 2 and figure 3, and what they leave out.

report      all files of an evaluation; page: as one HTML page
analysis    records to comparisons; statistics: means with intervals, paired tests
baselines   the simulator without a network: no motion, one constant θ
tables      the tables; figures: the pictures
settling    when a simulated motion has come to rest
collapse    whether the network gives the same θ whatever it sees
"""

from physics.lazy import exported

__getattr__ = exported(
    {
        "evaluation.paper.report": ("EvaluationError", "write_evaluation"),
        "evaluation.paper.analysis": ("Evaluation", "analyse"),
        "evaluation.paper.statistics": ("Comparison", "Summary", "compare", "summarise"),
        "evaluation.paper.collapse": ("CollapseCheck", "check_collapse"),
    }
)
