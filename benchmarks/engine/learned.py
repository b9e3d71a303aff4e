"""`engine`: free-flyers whose integers were learned, proposed to the tree first.

Each scene has its rectangles, and start and goal are drawn; some problems are solved, those of the
nearest ones are what is proposed for others (`knn`). `learned alone` takes the best proposal that
holds and asks the tree only where none does, so that there is always an answer; `tree, learned`
proves it.
"""

from __future__ import annotations

import time
from dataclasses import dataclass, field
from typing import TextIO

import numpy as np

from benchmarks.engine.flyers import RECTANGLES, STEPS
from climbplan.instances.free_flyer import build_free_flyer_problem
from climbplan.learning.library import Library, ProgramSignature
from climbplan.learning.neighbours import NearestProblems
from climbplan.program.problem import Problem, Theta
from climbplan.solvers.result import SolverResult
from climbplan.solvers.tree.branch_and_bound import solve_branch_and_bound

SCENES, SOLVED, ASKED = 3, 1000, 40
QUICK = 1, 60, 6
_PROPOSED = 20
_GAP = 1e-3
_NEAR = 0.01  # relative: as good as the optimum


@dataclass
class _Row:
    """What one way of solving did."""

    seconds: list[float] = field(default_factory=list)
    worse: list[float] = field(default_factory=list)  # than the optimum, relative
    asked: int = 0  # of these, how often the tree was asked for want of a proposal that holds

    def add(self, seconds: float, found: SolverResult, best: float) -> None:
        """One problem."""
        self.seconds.append(seconds)
        objective = np.inf if found.objective is None else found.objective
        self.worse.append(objective / best - 1.0)


def run_learned(seed: int, quick: bool, stream: TextIO) -> None:
    """Print one row for the tree as it is, and one each with what was learned."""
    scenes, solved, asked = QUICK if quick else (SCENES, SOLVED, ASKED)
    rows = {name: _Row() for name in ("tree, cold", "tree, learned", "learned alone")}
    for scene in range(scenes):
        problem = build_free_flyer_problem(np.random.default_rng([seed, scene]), STEPS, RECTANGLES)
        rng = np.random.default_rng([seed, scene, 1])
        near = NearestProblems.of(_library(problem, rng, solved), "strategies")
        for _ in range(asked):
            theta = problem.sample_parameters(rng)
            cold, spent = _cold(problem, theta)
            if cold.objective is None:
                continue  # proved: nothing is feasible, whatever was learned
            rows["tree, cold"].add(spent, cold, cold.objective)
            instance = problem.instance(theta)
            begin = time.process_time()
            first = near.candidates(problem.feature_vector(theta), _PROPOSED)
            found = solve_branch_and_bound(instance, _GAP, proposals=first)
            rows["tree, learned"].add(time.process_time() - begin, found, cold.objective)
            begin = time.process_time()
            first = near.candidates(problem.feature_vector(theta), _PROPOSED)
            found = solve_branch_and_bound(instance, _GAP, nodes=0, proposals=first)
            if found.x is None:
                rows["learned alone"].asked += 1
                found = solve_branch_and_bound(instance, _GAP)
            rows["learned alone"].add(time.process_time() - begin, found, cold.objective)
    print(
        f"\nfree-flyer, integers of the nearest of {solved} solved ones first, scenes: {scenes}\n"
        "engine          problems  feasible  within 1 %  worst by  none held  median [ms]"
        "   99 % [ms]",
        file=stream,
    )
    for name, row in rows.items():
        worse, here = np.array(row.worse), 1e3 * np.array(row.seconds)
        print(
            f"{name:<14}  {len(worse):8d}  {np.isfinite(worse).mean():8.0%}  "
            f"{(worse <= _NEAR).mean():10.1%}  {worse.max():8.1e}  {row.asked:9d}  "
            f"{np.median(here):11.2f}  {np.quantile(here, 0.99):10.2f}",
            file=stream,
        )


def _cold(problem: Problem, theta: Theta) -> tuple[SolverResult, float]:
    instance = problem.instance(theta)
    begin = time.process_time()
    found = solve_branch_and_bound(instance, _GAP)
    return found, time.process_time() - begin


def _library(problem: Problem, rng: np.random.Generator, count: int) -> Library:
    """Of the drawn problems those that have a solution."""
    thetas = [problem.sample_parameters(rng) for _ in range(count)]
    found = [(theta, _cold(problem, theta)[0]) for theta in thetas]
    kept = [(theta, r) for theta, r in found if r.x is not None]
    return Library.of(
        ProgramSignature.of(problem.program),
        np.array([problem.feature_vector(theta) for theta, _ in kept]),
        np.array([r.x for _, r in kept]),
        np.array([r.objective for _, r in kept]),
        np.array([r.assignment for _, r in kept]),
    )
