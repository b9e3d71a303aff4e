"""Alternatives chosen by an L1 relaxation and rounding, as SL1M chooses surfaces.

The choices of an instance are relaxed to slacks whose sum is least (`SlackRelaxation`). A choice of
which some slack vanishes is settled on that alternative. Where all are, the instance with these
alternatives is one convex program. Where some are not, the sum is weighted anew by the slacks
found, as often as that settles more; then the settled ones are kept and the others are tried one
after the other, the least slack first, each with a relaxation of its own, as the authors of SL1M
enumerate what their first program leaves open (which they do not weight). Nothing is proved by
this: an alternative that was settled on is never given up, and the first point found ends the
search.
"""

from __future__ import annotations

import time
from dataclasses import dataclass, replace

import numpy as np

from climbplan.arrays import Array, IntArray
from climbplan.program.instance import Instance
from climbplan.reformulations.pinned import Pinned
from climbplan.reformulations.slack_relaxation import SlackRelaxation
from climbplan.solvers.convex.sessions import session, solve_convex
from climbplan.solvers.result import FEASIBILITY, Answer, SolverResult, judged

PROGRAMS = 200  # convex programs at most, whatever the machine
_ZERO = 1e-6  # slack, in the unit of the rows, of an alternative that holds
_WEIGHTED = 4  # times that slacks are weighted anew
_NEAR = 1e-2  # slack below which they count the same, in the unit of the rows
_OPEN = -1


def solve_slack_selection(
    instance: Instance, gap: float = 1e-4, time_limit: float = np.inf
) -> SolverResult:
    """The first feasible point that relaxing and rounding leads to, at its alternatives' optimum.

    time_limit: [s]. `nodes` of the result counts convex programs. Without a point the status is
    `limit`: rounding proves nothing. The rest of the instance has to be convex.
    """
    begin = time.perf_counter()
    first = np.array([_OPEN if len(c.alternatives) > 1 else 0 for c in instance.choices], np.int64)
    stack: list[IntArray] = [first]
    programs, deepest, told = 0, 0, ""
    found: Array | None = None
    chosen = first
    while stack and programs < PROGRAMS and time.perf_counter() - begin < time_limit:
        chosen = stack.pop()
        relaxed = _relaxed(instance, chosen)
        programs += relaxed.programs
        told = told or relaxed.told(len(first))
        if relaxed.slacks is None:
            continue
        least = np.array([own.min() for own in relaxed.slacks])
        settled = np.flatnonzero((chosen == _OPEN) & (least <= _ZERO))
        chosen[settled] = [int(np.argmin(relaxed.slacks[c])) for c in settled]
        left = np.flatnonzero(chosen == _OPEN)
        deepest = max(deepest, len(chosen) - len(left))
        if not len(left):
            programs += 1
            found = _pinned(instance, chosen, gap)
            if found is not None:
                break
            continue
        branch = int(left[np.argmin(least[left])])
        # The last one put on the stack is the next
        for alternative in np.argsort(-relaxed.slacks[branch], kind="stable"):
            child = chosen.copy()
            child[branch] = alternative
            stack.append(child)
    words = f"{programs} convex programs, {told}"
    if found is None:
        ended = "all that was left open is tried" if not stack else "a limit was reached"
        words += f", later ones {deepest} at most: {ended}"
    return judged(
        instance,
        Answer(
            x=found,
            bound=-np.inf,
            infeasible=False,
            nodes=programs,
            time=time.perf_counter() - begin,
            solver="sl1-relaxation",
            log=(words,),
            assignment=None if found is None else chosen,
        ),
        gap,
        FEASIBILITY,
    )


@dataclass(frozen=True)
class _Relaxed:
    """Slacks (R,) of every choice where their weighted sum is least; None where nothing is."""

    slacks: list[Array] | None
    settled: tuple[int, ...]  # choices of which a slack vanishes, after each program

    @property
    def programs(self) -> int:
        return max(len(self.settled), 1)

    def told(self, choices: int) -> str:
        """What the first programs of a search settle."""
        if self.slacks is None:
            return "the first without any point"
        again = f", {self.settled[-1]} weighted anew" if len(self.settled) > 1 else ""
        return f"the first settles {self.settled[0]} of {choices} choices{again}"


def _relaxed(instance: Instance, chosen: IntArray) -> _Relaxed:
    choices = tuple(
        choice if k == _OPEN else replace(choice, alternatives=(choice.alternatives[k],))
        for choice, k in zip(instance.choices, chosen, strict=True)
    )
    form = SlackRelaxation().apply(replace(instance, choices=choices))
    solver = session("clarabel")  # of which only the cost changes
    best: list[Array] | None = None
    settled: list[int] = []
    for _ in range(_WEIGHTED + 1):
        x = solver.solve(form.instance).x
        if x is None:
            break
        slacks = form.of_choices(x)
        count = sum(bool(own.min() <= _ZERO) for own in slacks)
        if best is None or count > max(settled):
            best = slacks
        settled.append(count)
        if count == len(choices) or count < max(settled):
            break
        form = form.weighted(x, _NEAR)
    return _Relaxed(best, tuple(settled))


def _pinned(instance: Instance, chosen: IntArray, gap: float) -> Array | None:
    """The best point with these alternatives; None where there is none."""
    pinned = Pinned(np.zeros(instance.size), chosen, compact=True).apply(instance)
    return solve_convex(pinned.instance, "clarabel", gap).x
