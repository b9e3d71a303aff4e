"""`engine`: problems with products whose parameters change a little each time.

The damped cart-pole follows its own plan with noise on the state, its horizon recedes; the flyer's
start and goal and the pushed box's goal drift. The tree from its root beside the tree that begins
with the boxes and integers of the last.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from typing import TextIO

import numpy as np

from benchmarks.engine.bilinear import planar_push, turning_flyer
from benchmarks.engine.shipped import shipped_cart_pole
from climbplan.methods.sequence import ProblemSequence
from climbplan.methods.table import solve_instance
from climbplan.methods.task import MethodSettings
from climbplan.program.problem import Problem, Theta
from climbplan.solvers.result import SolverResult

COUNT, QUICK_COUNT = 20, 4
_SETTINGS = MethodSettings(gap=1e-3, time_limit=60.0)
_NOISE = 0.001  # of the cart-pole's state
_DRIFT = 0.01  # [m], [m/s] of the flyer's start and goal, standard deviation
_PUSHED = 0.002  # [m] and of the direction, of the box's goal

Next = Callable[[Problem, Theta, SolverResult, np.random.Generator], Theta]


def _followed(
    problem: Problem, theta: Theta, found: SolverResult, rng: np.random.Generator
) -> Theta:
    assert found.x is not None
    after = problem.values(found.x)["state"][1]
    return {**theta, "start": after + _NOISE * rng.normal(size=4)}


def _flown(problem: Problem, theta: Theta, found: SolverResult, rng: np.random.Generator) -> Theta:
    start, goal = np.asarray(theta["start"]), np.asarray(theta["goal"])
    return {
        **theta,
        "start": start + _DRIFT * rng.normal(size=4),
        "goal": goal + _DRIFT * rng.normal(size=2),
    }


def _pushed(problem: Problem, theta: Theta, found: SolverResult, rng: np.random.Generator) -> Theta:
    goal = np.asarray(theta["goal"]) + _PUSHED * rng.normal(size=4)
    return {"goal": np.concatenate([goal[:2], goal[2:] / np.linalg.norm(goal[2:])])}


# Problem, its next parameters, steps by which its horizon recedes, share of the count
PROBLEMS: dict[str, tuple[Callable[[], Problem], Next, int, float]] = {
    "cart-pole, damped, 10": (lambda: shipped_cart_pole().problem(), _followed, 1, 1.0),
    "turning flyer, 2": (lambda: turning_flyer(2), _flown, 0, 1.0),
    "turning flyer, 3": (lambda: turning_flyer(3), _flown, 0, 1.0),
    "planar push, 2": (lambda: planar_push(2), _pushed, 0, 1.0),
    "planar push, 3": (lambda: planar_push(3), _pushed, 0, 0.4),
}


def run_remembering(seed: int, quick: bool, stream: TextIO) -> None:
    """Print two rows for each problem; CPU milliseconds with all that is built."""
    print(
        "\nproducts, one problem after the other, gap 1e-3\n"
        "problem, steps         begins with  problems  proved  median [ms]   99 % [ms]   nodes"
        "  of the cold  cost off by",
        file=stream,
    )
    for name, (make, after, shift, share) in PROBLEMS.items():
        problem, rng = make(), np.random.default_rng(seed)
        count = max(2, round(share * (QUICK_COUNT if quick else COUNT)))
        sequence = ProblemSequence(problem, _SETTINGS)
        seconds, nodes = np.zeros((2, count)), np.zeros((2, count))
        proved, off = [0, 0], 0.0
        for number, (theta, cold, spent) in enumerate(_cold(problem, after, count, rng)):
            begin = time.process_time()
            warm = sequence.solve(theta, shift if number else 0).result
            seconds[:, number] = spent, time.process_time() - begin
            nodes[:, number] = cold.nodes, warm.nodes
            for k, found in enumerate((cold, warm)):
                proved[k] += found.status in ("optimal", "infeasible")
            if cold.objective is not None and warm.objective is not None:
                off = max(off, abs(warm.objective - cold.objective) / max(cold.objective, 1e-9))
        here = 1e3 * seconds[:, 1:]  # the first one has nothing to remember
        for k, begun in enumerate(("nothing", "the last")):
            print(
                f"{name:<21}  {begun:<11}  {count:8d}  {proved[k]:6d}  {np.median(here[k]):11.2f}"
                f"  {np.quantile(here[k], 0.99):10.2f}  {np.median(nodes[k, 1:]):6.0f}"
                f"  {np.median(here[k]) / np.median(here[0]):11.2f}  {off:11.1e}",
                file=stream,
            )


def _cold(
    problem: Problem, after: Next, count: int, rng: np.random.Generator
) -> Iterator[tuple[Theta, SolverResult, float]]:
    """Parameters, the answer of a tree from its root, and its seconds; the first has an answer."""
    theta: Theta = problem.sample_parameters(rng)
    solve_instance(problem, theta, "branch-and-bound", _SETTINGS)  # loads and compiles
    made = 0
    while made < count:
        begin = time.process_time()
        found = solve_instance(problem, theta, "branch-and-bound", _SETTINGS).result
        spent = time.process_time() - begin
        if found.x is None:
            theta = problem.sample_parameters(rng)
            continue
        yield theta, found, spent
        made += 1
        theta = after(problem, theta, found, rng)
