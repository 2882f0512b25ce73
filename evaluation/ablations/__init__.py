"""The networks without one of their parts each; `python -m evaluation.ablations` is the door.

rows         what is left out in each row
observation  contact posteriors that see less of a contact
training     generators trained with less, by train.py
scores       the numbers of a row; output: the table and the picture
"""

from physics.lazy import exported

__getattr__ = exported(
    {
        "evaluation.ablations.rows": ("OBSERVATION", "ROWS", "Row", "TRAINING"),
        "evaluation.ablations.output": ("Result",),
    }
)
