"""Coupled planning of a climb: P1 with envelopes, then P2 on the exact balance.

P1 in two parts: regions are chosen by the posture planner's branch and bound among those that can
hold a limb's load; with regions given, P1 is a convex program with McCormick envelopes. P2
keeps the toes and looks for forces (a linear program); where there are none, or on request, IPOPT
solves P with the regions of P1 from there. The answer is judged by the exact check of P. Its bound
is that of the postures alone: forces only take postures away.
"""

from __future__ import annotations

import time
from dataclasses import replace

import numpy as np

from climbplan.climb.coupled.envelopes import braced_envelope
from climbplan.climb.coupled.statement import coupled_program, envelope_range, loadable
from climbplan.climb.postures.explanation import explain_infeasible
from climbplan.climb.postures.planner import (
    PostureResult,
    refuse_unsuitable,
    rotation_warnings,
    to_rounds,
)
from climbplan.climb.postures.statement import PostureMargins, posture_program
from climbplan.climb.scene import ClimbScene
from climbplan.coupled.legs import POSITION_SCALE
from climbplan.coupled.search import least_error
from climbplan.errors import LimitReached
from climbplan.learning.envelope_box import Envelope
from climbplan.program import Program
from climbplan.program.instance import Index, Instance
from climbplan.program.polytope import Array
from climbplan.reformulations.local_envelopes import LocalForm
from climbplan.reformulations.pinned import PinnedForm
from climbplan.solvers.convex import solve_convex
from climbplan.solvers.ipopt import solve_ipopt
from climbplan.solvers.registry import solve
from climbplan.solvers.result import relative_gap

TOLERANCE = 1e-6  # of P's constraints: metres, weights, weights times metres


def plan_coupled(
    scene: ClimbScene,
    margins: PostureMargins | None = None,
    whole: bool = False,
    envelope: Envelope | None = None,
) -> PostureResult:
    """Postures whose forces balance, by `coupled`, or with `whole` by `coupled-nlp`.

    envelope: of all limbs; the braced robot's if left out. Raises Infeasible where postures alone
    have no solution, and LimitReached where the method finds none, which proves nothing.
    """
    refuse_unsuitable(scene)
    chosen = margins or PostureMargins()
    box = braced_envelope(scene) if envelope is None else envelope
    options = scene.spec.solver
    start = time.monotonic()
    scene = loadable(scene, box)
    postures = posture_program(scene, chosen)
    alone = postures.at()
    first = solve(alone, options.posture, gap=options.gap, time_limit=options.time_limit)
    if first.status == "infeasible":
        raise explain_infeasible(scene, postures, alone)
    if first.x is None or first.assignment is None:
        raise LimitReached(f"coupled planner: no postures within {options.time_limit:g} s")
    program = coupled_program(scene, chosen, box)
    instance = program.at()
    guess = np.clip(np.zeros(instance.size), instance.lower, instance.upper)
    guess[: alone.size] = first.x  # forces come behind the posture program's variables
    x, way = _balanced(scene, program, instance, guess, first.assignment, box, whole)
    result = replace(
        first,
        x=x,
        objective=instance.objective(x),
        status="feasible",
        solver=f"{first.solver}, {way}",
    )
    rounds = to_rounds(scene, program, result)
    return PostureResult(
        rounds=rounds,
        status="feasible",
        objective=instance.objective(x),
        bound=first.bound,
        gap=relative_gap(instance.objective(x), first.bound),
        nodes=first.nodes,
        solver=result.solver,
        sizes={**program.counts(), "seconds": time.monotonic() - start},
        warnings=rotation_warnings(rounds),
    )


def _balanced(
    scene: ClimbScene,
    program: Program,
    instance: Instance,
    first: Array,
    assignment: Index,
    box: Envelope,
    whole: bool,
) -> tuple[Array, str]:
    """A point of P with the chosen regions, and how it was found."""
    pinned = PinnedForm.of(instance).at(first, assignment, compact=True)
    x = first_stage(scene, program, pinned, box)
    if x is not None and not whole:
        projected = second_stage(program, pinned, x)
        if projected is not None:
            return projected, "Clarabel and HiGHS"
    start = first if x is None else x
    found = solve_ipopt(pinned, start=start, time_limit=scene.spec.solver.time_limit)
    if found.x is None:
        reason = "no point of P1" if x is None else "P2 found no balance at P1's postures"
        raise LimitReached(
            f"method {scene.spec.solver.method}: {reason}, and IPOPT none near them; the regions "
            "were chosen without forces, so this proves nothing"
        )
    return found.x, "IPOPT"


def first_stage(
    scene: ClimbScene, program: Program, pinned: Instance, box: Envelope
) -> Array | None:
    """P1 with regions given: the convex program with envelopes (n,), None without a solution."""
    within = envelope_range(scene, program, pinned, box, POSITION_SCALE)
    local = LocalForm.of(pinned).at(within)
    found = solve_convex(local, "clarabel", tolerance=TOLERANCE).x
    return None if found is None else found[: pinned.size]


def second_stage(program: Program, pinned: Instance, x: Array) -> Array | None:
    """P2, convex: forces at the postures of P1; None if none balance."""
    force = program.variables["force"]
    kept = np.ones(pinned.size, bool)
    kept[force.start : force.stop] = False
    found = least_error(pinned, x, np.flatnonzero(kept))
    if found is None or pinned.violation(found[0]) > TOLERANCE:
        return None
    return found[0]
