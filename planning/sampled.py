"""A scene in space planned by OMPL (RRT*, Karaman 2011) with our cost as its objective."""

import importlib
from typing import Any

import numpy as np

from palpate.data.source.layout import InputError
from palpate.planning.pressing import PressingCosts
from palpate.planning.roadmap import Blocked, Plan

SECONDS = 20.0
"""For which OMPL looks for cheaper ways."""


def plan_by_ompl(costs: PressingCosts, seconds: float = SECONDS) -> Plan:
    """The cheapest way that OMPL finds in so many seconds.

    Raises:
        InputError: OMPL is not installed.
        Blocked: it finds none.
    """
    try:
        base, geometric, util = (importlib.import_module(f"ompl.{name}") for name in ("base", "geometric", "util"))
    except ImportError as error:
        raise InputError('--planner ompl needs OMPL; pip install "palpate[ompl]".') from error

    def price(*states: Any) -> float:
        starts, ends = np.array([[[state[axis] for axis in range(3)]] for state in states])
        return float(costs.price(starts, ends)[0])

    class Objective(base.OptimizationObjective):
        def motionCost(self, one: Any, two: Any) -> Any:
            return base.Cost(price(one, two))

    class Motions(base.MotionValidator):
        def checkMotion(self, one: Any, two: Any) -> bool:
            return price(one, two) < np.inf

    util.setLogLevel(util.LogLevel.LOG_WARN)
    space, ends = base.RealVectorStateSpace(), np.stack([costs.start, costs.goal])
    for values in np.concatenate([costs.known["places"], ends]).T.tolist():
        space.addDimension(min(values), max(values))
    setup, states = geometric.SimpleSetup(space), [space.allocState(), space.allocState()]
    for axis in range(3):
        states[0][axis], states[1][axis] = ends[:, axis].tolist()
    information = setup.getSpaceInformation()
    information.setMotionValidator(Motions(information))
    setup.setStateValidityChecker(lambda state: price(state, state) < np.inf)
    setup.setOptimizationObjective(Objective(information))
    setup.setStartAndGoalStates(*states)
    setup.setPlanner(geometric.RRTstar(information))
    setup.solve(seconds)
    if not setup.haveExactSolutionPath():
        raise Blocked(f"OMPL found no way below limit_N in {seconds:g} s; take --planner roadmap, or raise the limit.")
    found = setup.getSolutionPath().getStates()
    return costs.plan(np.array([[state[axis] for axis in range(3)] for state in found]))
