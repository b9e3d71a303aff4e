"""The first intervals of a walk alone: small programs that say where its beginning can be.

A motion that costs no more than so much pays for its first intervals that less what all later ones
cost at least, so that the same statement of a shorter task holds its beginning. Its linear programs
are many times smaller than those of the whole, and the start is where ranges gain most, as it is
given: each head that is one interval longer begins from what the one before has drawn closer.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TypeVar

import highspy
import numpy as np

from climbplan.solvers.highs.model import rows_model, run_highs
from climbplan.walking.micp.ranges import Box
from climbplan.walking.micp.relaxed import SAG, infeasible, linear, relaxed
from climbplan.walking.micp.shrinking import shrunk
from climbplan.walking.micp.statement import Relaxation, relaxation
from climbplan.walking.micp.tube import Tube
from climbplan.walking.task.task import Goal, WalkTask

_T = TypeVar("_T", Tube, Box)
_WHOLE = ("low", "high", "off")  # of a box: states are of one knot more than intervals
SHORTEST = 3  # intervals of a head: the first step is the start's
WORTH = 0.003  # of the cost, that a head has to raise the bound by
_PAD = 1e-4  # of the cost, that later intervals may cost less than the solver says


@dataclass(frozen=True)
class Stated:
    """How a task is relaxed: what all programs of it have in common."""

    task: WalkTask
    tube: Tube
    most: float  # that motions cost
    arm_pieces: int
    height_pieces: int
    ratio: float  # of tangents
    turned: int | None = None  # as of `Frame`; heads have all of their own

    def program(self, box: Box | None, plain: bool = False) -> Relaxation:
        """Of all motions that a box holds; plain: as of `Frame`."""
        pieces = self.arm_pieces, self.height_pieces
        tube = self.tube if box is None else box.tube(self.tube)
        return relaxation(self.task, tube, self.most, *pieces, self.ratio, box, plain, self.turned)

    def head(self, box: Box, knots: int, later: float) -> Relaxation:
        """Of the first intervals of such motions, where later ones cost so much at least.

        Plain: of its hundreds of linear programs each takes half the time then.
        """
        begin = Stated(
            first_intervals(self.task, knots),
            _cut(self.tube, knots, tuple(vars(self.tube))),
            self.most - later,
            self.arm_pieces,
            self.height_pieces,
            self.ratio,
        )
        return begin.program(first_of_box(box, knots), plain=True)


@dataclass(frozen=True)
class Drawn:
    """What heads tell of motions."""

    box: Box
    later: tuple[float, ...]  # (N + 1) what intervals from a knot on cost at least


def drawn_by_heads(
    stated: Stated,
    program: Relaxation,
    seconds: float,
    clock: Callable[[], float],
    worth: float = WORTH,
) -> Drawn | None:
    """What ever longer heads tell of a program's motions; None if there are none.

    Until one does not raise what the whole costs at least by a share, or the time is over.
    """
    end, box, whole, before = clock() + seconds, program.box, program, -np.inf
    later = np.zeros(stated.task.knots + 1)
    for knots in range(SHORTEST, stated.task.knots):
        known = max((k for k, _ in relaxed(whole.model, SAG * stated.most, linear())), default=0.0)
        if np.isinf(known):
            return None
        if clock() >= end or known < before + worth * stated.most:
            break
        before = known
        least = later_than(whole, knots)
        if least is None:
            return None
        later[knots] = least
        found = drawn_by_head(stated, box, knots, tuple(later), 0, max(end - clock(), 0.0), clock)
        if found is None:
            return None
        box, whole = found, stated.program(found)
    # What is paid from a knot on is paid from any before it on, too.
    return Drawn(box, tuple(np.maximum.accumulate(later[::-1])[::-1].tolist()))


def drawn_by_head(
    stated: Stated,
    box: Box,
    knots: int,
    later: Sequence[float] | Mapping[int, float],
    first: int,
    seconds: float = np.inf,
    clock: Callable[[], float] = time.perf_counter,
) -> Box | None:
    """What the head of so many intervals tells of motions from a knot on; None without any."""
    head = stated.head(box, knots, later[knots])
    for _, at in relaxed(head.model, SAG * stated.most, linear()):
        if at is None:
            return None
    found = shrunk(head, seconds, clock, first)
    return with_head(box, found) if found is not None else None


def least_of_head(stated: Stated, box: Box, knots: int, later: float) -> float:
    """What motions of a box cost at least, by the head of so many intervals alone.

    later: what intervals after it cost at least. Infinite if there are no such motions.
    """
    head = stated.head(box, knots, later)
    found = (value for value, _ in relaxed(head.model, SAG * stated.most, linear()))
    return later + max(found, default=0.0)


def bound_drawn(
    stated: Stated,
    box: Box,
    rounds: int,
    left: Callable[[], float],
    clock: Callable[[], float],
) -> float:
    """What motions of a box cost at least, by rounds of linear programs that draw it closer.

    left: [s] for them; `stated.most` if there are no such motions.
    """
    bound = 0.0
    for after in range(rounds + 1):
        program = stated.program(box)
        found = (value for value, _ in relaxed(program.model, SAG * stated.most, linear()))
        bound = max(bound, min(max(found, default=0.0), stated.most))
        if bound >= stated.most or after == rounds or left() <= 0:
            break
        drawn = shrunk(program, left(), clock)
        if drawn is None:
            return stated.most
        box = drawn
    return bound


def later_than(program: Relaxation, knots: int) -> float | None:
    """As of `least_after`, with room for what the solver is off."""
    least = least_after(program, knots)
    return None if least is None else max(least - _PAD * program.most, 0.0)


def least_after(program: Relaxation, knots: int) -> float | None:
    """What intervals from a knot on cost at least; 0 if that is not known, None without a point."""
    solver = linear()
    solver.passModel(rows_model(program.model, relaxed=True))
    cost, given = program.paid_after(knots)
    solver.changeColsCost(len(cost), np.arange(len(cost), dtype=np.int32), cost)
    run_highs(solver)
    status = solver.getModelStatus()
    if status == highspy.HighsModelStatus.kInfeasible:
        return None if infeasible(solver) else 0.0
    if status != highspy.HighsModelStatus.kOptimal:
        return 0.0
    found = float(solver.getInfo().objective_function_value) - program.model.constant + given
    return max(found, 0.0)


def first_intervals(task: WalkTask, knots: int) -> WalkTask:
    """The first so many intervals of a task; a goal at its end is left out."""
    kept = {name: value[:knots] for name, value in vars(task.reference).items()}
    reference = replace(task.reference, **kept)
    return replace(task, knots=knots, goal=Goal.anywhere(), reference=reference)


def first_of_box(box: Box, knots: int) -> Box:
    """What is known of the first intervals; fewer velocities cost no more than all of them."""
    states = _cut(box, knots, ("low", "high"))
    return _cut(states, knots - 1, tuple(name for name in vars(box) if name not in _WHOLE))


def with_head(box: Box, head: Box) -> Box:
    """What is known of a motion, and more of its first intervals."""
    copies = {name: value.copy() for name, value in vars(box).items()}
    for name, value in vars(head).items():
        if name != "off":  # of the head's velocities only
            copies[name][: len(value)] = value
    return Box(**copies)


def _cut(one: _T, knots: int, names: tuple[str, ...]) -> _T:
    """Arrays of these names up to a knot."""
    return replace(one, **{name: getattr(one, name)[: knots + 1] for name in names})
