"""Paths of an instrument's tip that pay for the tissue they push aside (Frank 2010, section VII).

scene      the file that names tissue, obstacles, start and goal, and where straight lines meet them
press      what it takes to push the tip into a piece of tissue, simulated
cost_table such presses, cached for a piece of tissue and generalised by a kernel
roadmap    probabilistic road map and the cheapest way through it
pictures   the plan drawn
"""

from palpate.common.lazy import exported

__getattr__ = exported(
    {
        "palpate.planning.scene": ("PlanScene", "SoftObject", "read_plan_scene"),
        "palpate.planning.press": ("PressCurve", "simulate_press"),
        "palpate.planning.cost_table": ("CostTable", "open_table", "open_tables"),
        "palpate.planning.roadmap": ("Blocked", "Plan", "find_plan"),
    },
)
