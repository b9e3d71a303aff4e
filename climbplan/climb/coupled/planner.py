"""Coupled planning of a climb (chapter 5.2): toes and forces by one of several methods.

coupled        P1 with one envelope, P2 convex, IPOPT where that fails
coupled-modes  P1 with one of several envelopes in each round, then P2
coupled-nlp    P1, then IPOPT on everything
coupled-micp   envelopes on a grid: a bound of P, or with a learned envelope a faster search
spatial        SCIP on P itself

The answer is judged by the exact check of P, whatever the method. What the reported bound is valid
for is told with it.
"""

from __future__ import annotations

import time
from dataclasses import dataclass, field, replace
from typing import Any

from climbplan.climb.coupled.accurate import solve_accurate
from climbplan.climb.coupled.envelopes import NamedEnvelope, chosen_envelopes
from climbplan.climb.coupled.modes import first_stage_with_modes
from climbplan.climb.coupled.preparation import Prepared, prepare
from climbplan.climb.coupled.stages import Candidate, put_right, two_stages
from climbplan.climb.postures.explanation import BOUND_SCOPE
from climbplan.climb.postures.planner import (
    PostureResult,
    refuse_unsuitable,
    rotation_warnings,
    to_rounds,
)
from climbplan.climb.postures.statement import PostureMargins
from climbplan.climb.scene.climb_scene import ClimbScene
from climbplan.errors import NotProved
from climbplan.solvers.result import SolverResult, relative_gap
from climbplan.solvers.scip.bilinear import solve_minlp_scip

_P = (
    "postures and contact forces of the ends of rounds: rotations linearised, workspaces as balls, "
    "friction pyramids inscribed, every limb carrying posture.least_load"
)
ALONE = f"{_P}; from postures without forces, which is lower"


@dataclass(frozen=True)
class Answer:
    """What a method found."""

    candidate: Candidate
    bound: float  # valid for P
    holds_for: str
    nodes: int
    notes: dict[str, Any] = field(default_factory=dict)


def plan_coupled(scene: ClimbScene, margins: PostureMargins | None = None) -> PostureResult:
    """Postures whose forces balance, by the method of the spec.

    Raises NotProved where postures alone have no solution, or P has none, or the method finds none,
    and LimitReached where its time is over.
    """
    refuse_unsuitable(scene)
    start = time.monotonic()
    prepared = prepare(scene, margins or PostureMargins())
    answer = _METHODS[scene.spec.solver.method](prepared)
    x = answer.candidate.x
    objective = prepared.instance.objective(x)
    bound = min(answer.bound, objective)
    gap = relative_gap(objective, bound)
    result = SolverResult(
        status="feasible",
        x=x,
        assignment=answer.candidate.assignment,
        objective=objective,
        bound=bound,
        gap=gap,
        nodes=answer.nodes,
        time=time.monotonic() - start,
        solver=f"{prepared.solver}, {answer.candidate.way}",
        log=(),
    )
    rounds = to_rounds(prepared.scene, prepared.program, result)
    sizes = {
        **prepared.program.counts(),
        **answer.notes,
        "bound_holds_for": answer.holds_for,
        "seconds": result.time,
    }
    return PostureResult(
        rounds=rounds,
        status="optimal" if gap <= scene.spec.solver.gap else "feasible",
        objective=objective,
        bound=bound,
        gap=gap,
        nodes=answer.nodes,
        solver=result.solver,
        sizes=sizes,
        warnings=rotation_warnings(scene, rounds),
    )


def _not_found(prepared: Prepared, why: str) -> NotProved:
    method = prepared.scene.spec.solver.method
    return NotProved(
        f"method {method}: {why}",
        because=f"method {method} searches from one envelope or start",
        stage="posture",
    )


def told(*envelopes: NamedEnvelope) -> dict[str, Any]:
    """Envelopes as reports name them."""
    return {"envelopes": {e.name: e.fit for e in envelopes}}


def _coupled(prepared: Prepared) -> Answer:
    options = prepared.scene.spec.solver
    envelope = chosen_envelopes(prepared.scene)[0]
    local = options.method == "coupled-nlp"
    found = two_stages(prepared, envelope.box, prepared.left, local)
    if found is None:
        raise _not_found(
            prepared, f"no point of P1 with envelope {envelope.name} that P2 or IPOPT puts right"
        )
    return Answer(found, prepared.bound, ALONE, prepared.nodes, told(envelope))


def _modes(prepared: Prepared) -> Answer:
    envelopes = chosen_envelopes(prepared.scene, several=True)
    first = first_stage_with_modes(prepared, envelopes, prepared.left)
    names = ", ".join(e.name for e in envelopes)
    if first is None:
        raise _not_found(prepared, f"no point of P1 with envelopes {names}")
    found = put_right(prepared, first.candidate, prepared.left)
    if found is None:
        raise _not_found(prepared, "neither P2 nor IPOPT puts P1 right")
    notes = {**told(*envelopes), "modes": list(first.modes)}
    return Answer(found, prepared.bound, ALONE, prepared.nodes + first.nodes, notes)


def _known(prepared: Prepared) -> Candidate | None:
    """A point of P to begin from: forces at the postures alone, or IPOPT from there."""
    first = Candidate(prepared.guess, prepared.assignment, "postures")
    return put_right(prepared, first, prepared.left)


def _accurate(prepared: Prepared) -> Answer:
    options = prepared.scene.spec.solver
    envelope = chosen_envelopes(prepared.scene)[0] if options.envelopes else None
    known = _known(prepared)
    if known is not None and envelope is None:
        cost = prepared.instance.objective(known.x)
        if relative_gap(cost, prepared.bound) <= options.gap:
            closed = {"closed_by": "postures alone: forces balance at them"}
            return Answer(known, prepared.bound, f"{_P}; closed by postures alone", 0, closed)
    found = solve_accurate(
        prepared,
        known,
        None if envelope is None else envelope.box,
        options.mixed,
        options.pieces,
        options.gap,
        prepared.left,
    )
    if found.infeasible and envelope is None:
        raise NotProved(
            f"no postures with forces that balance: the mixed-integer relaxation on "
            f"{options.pieces} pieces has no solution (method {options.method})",
            because=f"the program has {BOUND_SCOPE}; every limb carries posture.least_load",
            stage="posture",
        )
    if found.best is None:
        raise _not_found(prepared, f"no point of P within {options.time_limit:g} s")
    micp: dict[str, Any] = {
        "binaries": found.binaries,
        "variables": found.variables,
        "rows": found.rows,
        "nodes": found.nodes,
        "tightening_programs": found.tightening,
        "tightening_seconds": found.tightening_time,
        "solver_seconds": found.solver_time,
        "solver": found.solver,
    }
    if envelope is None:
        bound = max(found.bound, prepared.bound)
        held = f"{_P}; from envelopes on {options.pieces} pieces of each toe coordinate"
        return Answer(found.best, bound, held, found.nodes, {"micp": micp})
    micp["value_within_envelope"] = found.bound
    notes = {**told(envelope), "micp": micp}
    held = f"{ALONE}; the program's own value is that within the envelope, which is no bound"
    return Answer(found.best, prepared.bound, held, found.nodes, notes)


def _spatial(prepared: Prepared) -> Answer:
    options = prepared.scene.spec.solver
    known = _known(prepared)
    found = solve_minlp_scip(
        prepared.instance,
        gap=options.gap,
        time_limit=prepared.left,
        start=None if known is None else known.x,
    )
    if found.status == "infeasible":
        raise NotProved(
            f"no postures with forces that balance: {found.log[-1]}",
            because=f"the program has {BOUND_SCOPE}; every limb carries posture.least_load",
            stage="posture",
        )
    best = known
    if found.x is not None and found.assignment is not None and found.objective is not None:
        own = Candidate(found.x, found.assignment, "SCIP")
        if known is None or found.objective < prepared.instance.objective(known.x):
            best = own
    if best is None:
        raise _not_found(prepared, f"no point of P within {options.time_limit:g} s")
    best = replace(best, way=f"{best.way}, SCIP") if best is known else best
    notes = {"scip": found.log[-1]}
    return Answer(best, max(found.bound, prepared.bound), f"{_P}; from SCIP", found.nodes, notes)


_METHODS = {
    "coupled": _coupled,
    "coupled-nlp": _coupled,
    "coupled-modes": _modes,
    "coupled-micp": _accurate,
    "spatial": _spatial,
}
