"""Select alternatives by an L1 relaxation and rounding, as SL1M selects surfaces.

The choices of an instance are relaxed to slacks with minimal sum (`SlackRelaxation`). A choice with
a vanishing slack is fixed to that alternative. If all are fixed, the instance with these
alternatives is one convex program. Otherwise the sum is reweighted by the slacks (Candes, Wakin and
Boyd 2008), as long as that fixes more choices. The fixed ones are then kept, and the others are
tried one after the other, the smallest slack first, each with a relaxation of its own. The authors
of SL1M enumerate open choices in the same way, without reweighting. The method proves nothing:
fixed alternatives are never revised, and the first point found ends the search.
"""

from __future__ import annotations

import time
from dataclasses import dataclass, replace

import numpy as np

from climbplan.arrays import Array, IntArray
from climbplan.program.instance import Instance
from climbplan.reformulations.fixed_integers import FixedIntegers
from climbplan.reformulations.slack_relaxation import SlackRelaxation
from climbplan.solvers.convex.sessions import create_session, solve_convex
from climbplan.solvers.result import FEASIBILITY, Answer, SolverResult, judge_answer

MAX_PROGRAMS = 200  # largest number of convex programs, on any machine
_SLACK_TOLERANCE = 1e-6  # slack of an alternative that holds, in the unit of the rows
_MAX_REWEIGHTINGS = 4  # largest number of reweightings
_WEIGHT_REGULARISATION = 1e-2  # slack below which weights are equal, in the unit of the rows
_OPEN = -1


def solve_slack_selection(
    instance: Instance, gap: float = 1e-4, time_limit: float = np.inf
) -> SolverResult:
    """Return the first feasible point of the search, optimal for its alternatives.

    `nodes` of the result counts convex programs. Without a point the status is `limit`, since
    rounding proves nothing.

    Args:
        instance: Instance that is convex apart from choices.
        gap: Relative gap of the final convex program.
        time_limit: Time limit [s].
    """
    begin = time.perf_counter()
    root = np.array([_OPEN if len(c.alternatives) > 1 else 0 for c in instance.choices], np.int64)
    stack: list[IntArray] = [root]
    programs, max_fixed, summary = 0, 0, ""
    solution: Array | None = None
    chosen = root
    while stack and programs < MAX_PROGRAMS and time.perf_counter() - begin < time_limit:
        chosen = stack.pop()
        relaxed = _solve_relaxation(instance, chosen)
        programs += relaxed.num_programs
        summary = summary or relaxed.summarise(len(root))
        if relaxed.slacks is None:
            continue
        min_slacks = np.array([slacks.min() for slacks in relaxed.slacks])
        fixed = np.flatnonzero((chosen == _OPEN) & (min_slacks <= _SLACK_TOLERANCE))
        chosen[fixed] = [int(np.argmin(relaxed.slacks[c])) for c in fixed]
        open_choices = np.flatnonzero(chosen == _OPEN)
        max_fixed = max(max_fixed, len(chosen) - len(open_choices))
        if not len(open_choices):
            programs += 1
            solution = _solve_fixed(instance, chosen, gap)
            if solution is not None:
                break
            continue
        branch = int(open_choices[np.argmin(min_slacks[open_choices])])
        # The alternative pushed last is processed next
        for alternative in np.argsort(-relaxed.slacks[branch], kind="stable"):
            child = chosen.copy()
            child[branch] = alternative
            stack.append(child)
    message = f"{programs} convex programs, {summary}"
    if solution is None:
        ended = "all that was left open is tried" if not stack else "a limit was reached"
        message += f", later ones {max_fixed} at most: {ended}"
    answer = Answer(
        x=solution,
        bound=-np.inf,
        infeasible=False,
        nodes=programs,
        time=time.perf_counter() - begin,
        solver="sl1-relaxation",
        log=(message,),
        assignment=None if solution is None else chosen,
    )
    return judge_answer(instance, answer, gap, FEASIBILITY)


@dataclass(frozen=True)
class _SlackSolution:
    """Slacks (R,) of every choice at the minimum of their weighted sum; None without a point."""

    slacks: list[Array] | None
    num_fixed: tuple[int, ...]  # number of choices with a vanishing slack, after each program

    @property
    def num_programs(self) -> int:
        """Number of convex programs."""
        return max(len(self.num_fixed), 1)

    def summarise(self, choices: int) -> str:
        """Summarise what the first programs of a search fix."""
        if self.slacks is None:
            return "the first without any point"
        reweighted = f", {self.num_fixed[-1]} weighted anew" if len(self.num_fixed) > 1 else ""
        return f"the first settles {self.num_fixed[0]} of {choices} choices{reweighted}"


def _solve_relaxation(instance: Instance, chosen: IntArray) -> _SlackSolution:
    """Solve the relaxation with reweighting."""
    choices = tuple(
        choice if k == _OPEN else replace(choice, alternatives=(choice.alternatives[k],))
        for choice, k in zip(instance.choices, chosen, strict=True)
    )
    form = SlackRelaxation().apply(replace(instance, choices=choices))
    solver = create_session("clarabel")  # of which only the cost changes
    best: list[Array] | None = None
    num_fixed: list[int] = []
    for _ in range(_MAX_REWEIGHTINGS + 1):
        x = solver.solve(form.instance).x
        if x is None:
            break
        slacks = form.split_slacks(x)
        num_vanishing = sum(
            bool(choice_slacks.min() <= _SLACK_TOLERANCE) for choice_slacks in slacks
        )
        if best is None or num_vanishing > max(num_fixed):
            best = slacks
        num_fixed.append(num_vanishing)
        if num_vanishing == len(choices) or num_vanishing < max(num_fixed):
            break
        form = form.reweight(x, _WEIGHT_REGULARISATION)
    return _SlackSolution(best, tuple(num_fixed))


def _solve_fixed(instance: Instance, chosen: IntArray, gap: float) -> Array | None:
    """Return the best point with these alternatives; None where there is none."""
    fixed = FixedIntegers(np.zeros(instance.size), chosen, compact=True).apply(instance)
    return solve_convex(fixed.instance, "clarabel", gap).x
