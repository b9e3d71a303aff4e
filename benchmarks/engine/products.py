"""`engine`: problems with products, by the tree in space and by SCIP.

A cart-pole between walls that damp (`specs/cart_pole.py`), a flyer that turns, a pushed box.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import TextIO

import numpy as np

from benchmarks.engine.bilinear import planar_push, turning_flyer
from benchmarks.engine.shipped import shipped_cart_pole
from climbplan.methods.table import solve_instance
from climbplan.methods.task import Method, MethodSettings
from climbplan.program.problem import Problem

PROBLEMS: dict[str, Callable[[], Problem]] = {
    "cart-pole, damped, 10": lambda: shipped_cart_pole().problem(),
    "turning flyer, 2": lambda: turning_flyer(2),
    "turning flyer, 3": lambda: turning_flyer(3),
    "planar push, 2": lambda: planar_push(2),
    "planar push, 3": lambda: planar_push(3),
}
METHODS: tuple[Method, ...] = ("branch-and-bound", "minlp-scip")
COUNT, QUICK_COUNT = 10, 2
_SETTINGS = MethodSettings(gap=1e-3, time_limit=60.0)


def run_products(seed: int, quick: bool, stream: TextIO) -> None:
    """Print one row for each problem and method; CPU milliseconds with all that is built."""
    print(
        "\nproducts, branched on in space, gap 1e-3\n"
        "problem, steps         products  binaries  engine            problems  proved  "
        "median [ms]   99 % [ms]   nodes  of the tree  cost off by",
        file=stream,
    )
    for name, make in PROBLEMS.items():
        problem, rng = make(), np.random.default_rng(seed)
        thetas = [problem.sample_parameters(rng) for _ in range(QUICK_COUNT if quick else COUNT)]
        for method in METHODS:  # loads and compiles where it has to
            solve_instance(problem, thetas[0], method, _SETTINGS)
        own: list[float | None] = []
        median = 1.0
        for method in METHODS:
            seconds, nodes, proved, off = [], [], 0, 0.0
            for number, theta in enumerate(thetas):
                begin = time.process_time()
                found = solve_instance(problem, theta, method, _SETTINGS).result
                seconds.append(time.process_time() - begin)
                nodes.append(found.nodes)
                proved += found.status in ("optimal", "infeasible")
                if method == METHODS[0]:
                    own.append(found.objective)
                best = own[number]
                if best is not None and found.objective is not None:
                    off = max(off, abs(found.objective - best) / max(abs(best), 1e-9))
            here = 1e3 * np.array(seconds)
            median = float(np.median(here)) if method == METHODS[0] else median
            instance = problem.instance(thetas[0])
            print(
                f"{name:<21}  {instance.products.count:8d}  {instance.binary_count:8d}  "
                f"{method:<16}  {len(here):8d}  {proved:6d}  {np.median(here):11.2f}  "
                f"{np.quantile(here, 0.99):10.2f}  {np.median(nodes):6.0f}  "
                f"{np.median(here) / median:11.2f}  {off:11.1e}",
                file=stream,
            )
