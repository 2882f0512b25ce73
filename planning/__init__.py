"""Paths of an instrument's tip that pay for the tissue they push aside (Frank 2010, section VII).

scene      the file that names tissue, obstacles, start and goal, and where straight lines meet them
press      what it takes to push the tip into a piece of tissue, simulated
cost_table such presses, cached for a piece of tissue and generalised by a kernel
roadmap    probabilistic road map and A*
pictures   the plan drawn
"""

from physics.lazy import exported

__getattr__ = exported(
    {
        "planning.scene": ("PlanScene", "SoftObject", "read_plan_scene"),
        "planning.press": ("PressCurve", "simulate_press"),
        "planning.cost_table": ("CostTable", "open_table"),
        "planning.roadmap": ("Blocked", "Plan", "find_plan"),
    }
)
