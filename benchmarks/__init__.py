"""Measurements against known truth, the papers' tables and the clock; `python -m benchmarks.NAME`. Not installed.

goldens      numbers that a change must leave as they are
recovery     synthetic clips with known truth against the best that is possible
path_traced  presses in videos by a renderer that shares no code with this project
path_tracer  such videos, rendered by Mitsuba 3
compare_with_truth  results of `palpate infer` on synthetic clips
real         real clips, judged on frames kept back from the fit
online       Table II of Liang 2024: the online estimator on simulated pulls
palpation    moduli from simulated palpations, as in Frank 2010
instruments  automatic masks against outlines that people drew
inference    time of networks and of whole videos
rollout      time of the rollout, beside JAX's
alarm        false alarms of a limit of force against missed crossings
harness      common parts: experiments, their resumption, and tables
"""

import sys

if sys.argv[0] == "-m":  # `python -m benchmarks.NAME` looks for the program, before its slow imports
    from palpate.common.doors import enter_door

    enter_door()
