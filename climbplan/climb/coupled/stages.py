"""P1 and P2 of a climb (chapter 5.2.1): envelopes in place of products, then products put right.

P1 with regions given is convex. P2 keeps the toes of P1 and looks for forces: linear, or quadratic
where forces cost. The nonlinear program (IPOPT) moves toes and forces together.
"""

from __future__ import annotations

import time
from dataclasses import dataclass

import numpy as np

from climbplan.arrays import Array, IntArray
from climbplan.climb.coupled.preparation import Prepared
from climbplan.climb.coupled.statement import envelope_range
from climbplan.climb.envelopes.search import least_error, linear_with
from climbplan.learning.envelope_box import Envelope
from climbplan.program import Program
from climbplan.program.instance import Instance
from climbplan.reformulations.local_envelopes import LocalForm
from climbplan.solvers.convex.sessions import solve_convex
from climbplan.solvers.ipopt.instances import solve_ipopt
from climbplan.solvers.registry import solve

TOLERANCE = 1e-6  # of P's constraints: metres, weights, weights times metres


@dataclass(frozen=True)
class Candidate:
    """A point with all choices made: of P1, or of P."""

    x: Array
    assignment: IntArray
    way: str  # how it was found


def first_stage(prepared: Prepared, pinned: Instance, envelope: Envelope) -> Array | None:
    """P1 with regions given (n,): one convex program; None without a solution."""
    within = envelope_range(prepared.program, pinned, envelope, prepared.origin)
    if (within.lower > within.upper).any():
        return None
    found = solve_convex(LocalForm.of(pinned).at(within), "clarabel", tolerance=TOLERANCE).x
    return None if found is None else found[: pinned.size]


def first_stage_with_regions(
    prepared: Prepared, envelope: Envelope, time_limit: float
) -> Candidate | None:
    """P1 with its choices of regions, by branch and bound; None if none was found in time."""
    instance = prepared.instance
    within = envelope_range(prepared.program, instance, envelope, prepared.origin)
    if (within.lower > within.upper).any():
        return None
    local = LocalForm.of(instance).at(within)
    found = solve(local, "branch-and-bound", gap=1e-3, time_limit=time_limit)
    if found.x is None or found.assignment is None:
        return None
    return Candidate(found.x[: instance.size], found.assignment, "branch and bound")


def second_stage(program: Program, pinned: Instance, x: Array) -> Array | None:
    """P2, convex: forces at the postures of P1; None if none balance."""
    force = program.variables["force"]
    kept = np.ones(pinned.size, bool)
    for name in ("force", "moment"):  # moments of feet of finite size follow their forces
        if name in program.variables:
            own = program.variables[name]
            kept[own.start : own.stop] = False
    held = np.flatnonzero(kept)
    if pinned.P.indptr[force.stop] > pinned.P.indptr[force.start]:
        found = solve_convex(linear_with(pinned, x, held), "clarabel", tolerance=TOLERANCE).x
    else:
        answer = least_error(pinned, x, held)
        found = None if answer is None else answer[0]
    if found is None or pinned.violation(found) > TOLERANCE:
        return None
    return found


def whole(pinned: Instance, start: Array, time_limit: float) -> Array | None:
    """Toes and forces together by IPOPT; None if it finds no point of P."""
    return solve_ipopt(pinned, start=start, time_limit=time_limit).x


def put_right(
    prepared: Prepared, first: Candidate, time_limit: float, local: bool = False
) -> Candidate | None:
    """P2 from a point of P1: convex, or with `local` (or where that fails) by IPOPT."""
    begin = time.monotonic()
    pinned = prepared.pinned(first.x, first.assignment)
    if not local:
        found = second_stage(prepared.program, pinned, first.x)
        if found is not None:
            return Candidate(found, first.assignment, f"{first.way}, P2 convex")
    left = time_limit - (time.monotonic() - begin)
    found = whole(pinned, first.x, left) if left > 0 else None
    return None if found is None else Candidate(found, first.assignment, f"{first.way}, IPOPT")


def two_stages(
    prepared: Prepared, envelope: Envelope, time_limit: float, local: bool = False
) -> Candidate | None:
    """P1 -> P2 with the regions of the postures alone, or where P1 has none, with its own."""
    begin = time.monotonic()
    pinned = prepared.pinned(prepared.guess, prepared.assignment)
    x = first_stage(prepared, pinned, envelope)
    if x is not None:
        candidate = Candidate(x, prepared.assignment, "P1 convex")
        found = put_right(prepared, candidate, time_limit, local)
        if found is not None:
            return found
    left = time_limit - (time.monotonic() - begin)
    other = first_stage_with_regions(prepared, envelope, left) if left > 0 else None
    left = time_limit - (time.monotonic() - begin)
    if other is None or left <= 0:
        return None
    return put_right(prepared, other, left, local)
