"""`engine`, third table: a free-flyer among eight rectangles, from nothing.

5 steps, 160 binaries, thrust of bounded norm (arXiv 2107.08143). SCIP gets convex hulls, or
indicators with its own cones; HiGHS big-M rows or convex hulls, with tangents for what is round.
Every contender is timed with the form that it needs, in CPU milliseconds.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import TextIO

import numpy as np

from climbplan.instances.free_flyer import build_free_flyer
from climbplan.program.instance import Instance
from climbplan.reformulations.base import Reformulation
from climbplan.reformulations.disjunctions import BigM, ConvexHull, DisjunctiveForm
from climbplan.solvers.registry import solve
from climbplan.solvers.result import Answer, SolverResult, judge_answer

STEPS, RECTANGLES = 5, 8
COUNT, QUICK_COUNT = 100, 4
OTHERS, QUICK_OTHERS = 10, 2  # of these, what slow contenders get
_GAP, _LIMIT = 1e-3, 60.0  # relative, [s]
_TOLERANCE = 1e-5  # of rows


def _highs(instance: Instance, by: Reformulation[DisjunctiveForm]) -> SolverResult:
    form = by.apply(instance)
    found = solve(form.instance, "highs", _GAP, _LIMIT)
    x = None if found.x is None else found.x[: instance.size]
    picks = None if found.x is None else form.decode_alternatives(found.x)
    infeasible = found.status == "infeasible"
    answer = Answer(x, found.bound, infeasible, found.nodes, found.time, "highs", found.log, picks)
    return judge_answer(instance, answer, _GAP, _TOLERANCE)


_TREE = "tree"
CONTENDERS: dict[str, Callable[[Instance], SolverResult]] = {
    _TREE: lambda i: solve(i, "branch-and-bound", _GAP, _LIMIT),
    "scip, hulls": lambda i: solve(i, "scip", _GAP, _LIMIT),
    "scip, indicators": lambda i: solve(i, "minlp-scip", _GAP, _LIMIT),
    "highs, big-M": lambda i: _highs(i, BigM()),
    "highs, hulls": lambda i: _highs(i, ConvexHull()),
}


def run_flyers(seed: int, quick: bool, stream: TextIO) -> None:
    """Print one row for each contender."""
    count, others = (QUICK_COUNT, QUICK_OTHERS) if quick else (COUNT, OTHERS)
    spent: dict[str, list[float]] = {name: [] for name in CONTENDERS}
    proved = dict.fromkeys(CONTENDERS, 0)
    off = dict.fromkeys(CONTENDERS, 0.0)
    small = build_free_flyer(np.random.default_rng(seed), 2, 2)
    for contender in CONTENDERS.values():  # loads and compiles where it has to
        contender(small)
    for number in range(count):
        instance = build_free_flyer(np.random.default_rng([seed, number]), STEPS, RECTANGLES)
        own: float | None = None
        for name, contender in CONTENDERS.items():
            if name != _TREE and number >= others:
                continue
            begin = time.process_time()
            found = contender(instance)
            spent[name].append(time.process_time() - begin)
            proved[name] += found.status in ("optimal", "infeasible")
            own = found.objective if name == _TREE else own
            if own is not None and found.objective is not None:
                off[name] = max(off[name], abs(found.objective - own) / max(abs(own), 1e-9))
    _print(spent, proved, off, others, stream)


def _print(
    spent: dict[str, list[float]],
    proved: dict[str, int],
    off: dict[str, float],
    others: int,
    stream: TextIO,
) -> None:
    """Shares are of the same problems."""
    print(
        f"\nfree-flyer, {STEPS} steps, {RECTANGLES} rectangles, "
        f"{4 * STEPS * RECTANGLES} binaries\n"
        "engine            problems  proved  median [ms]   99 % [ms]  of the tree  cost off by",
        file=stream,
    )
    own = np.median(spent[_TREE][:others])
    for name, seconds in spent.items():
        here = 1e3 * np.array(seconds)
        print(
            f"{name:<16}  {len(here):8d}  {proved[name]:6d}  {np.median(here):11.2f}  "
            f"{np.quantile(here, 0.99):10.2f}  {np.median(seconds[:others]) / own:11.2f}  "
            f"{off[name]:11.1e}",
            file=stream,
        )
