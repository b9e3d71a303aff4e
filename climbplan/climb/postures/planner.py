"""First stage: the posture sequence, by global mixed-integer optimisation.

Equation numbers are those of X. Lin (UCLA 2022).
"""

from __future__ import annotations

import logging
import time
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np

from climbplan.arrays import Array
from climbplan.climb.plan.climb_plan import Rounds
from climbplan.climb.postures.explanation import BOUND_SCOPE, NoPostures, explain_infeasible
from climbplan.climb.postures.statement import (
    LinearisedRotation,
    PostureMargins,
    build_posture_program,
)
from climbplan.climb.scene.climb_scene import ClimbScene
from climbplan.climb.scene.within_reach import find_usable_surfaces
from climbplan.errors import LimitReached, Unresolved, UsageError
from climbplan.program import Program
from climbplan.solvers.registry import solve
from climbplan.solvers.result import KnownResult, SolverResult

LINEAR_ROTATION_LIMIT = np.deg2rad(15.0)  # beyond it eq. (5.5) is off by over 3 % about one axis

_MIN_REPORTED_ALTERNATIVES = 1000  # alternatives from which a problem's size is told before
_log = logging.getLogger(__name__)


@dataclass(frozen=True)
class PostureResult:
    """Postures with what is known of their optimality."""

    rounds: Rounds
    status: Literal["optimal", "feasible"]
    objective: float  # posture cost [m^2]
    bound: float | None  # valid lower bound, None where the method gives none
    gap: float | None  # relative
    nodes: int  # branch-and-bound nodes, or NLP starts
    solver: str
    sizes: dict[str, Any]
    warnings: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()  # for people, of what needs no action
    warm_start: KnownResult | None = None  # for planning again with wider margins


def plan_postures(
    scene: ClimbScene,
    margins: PostureMargins | None = None,
    save_model: Path | None = None,
    previous: PostureResult | None = None,
    nodes: float = np.inf,
    explain: bool = True,
) -> PostureResult:
    """Return globally optimal postures under linearised rotation (method `micp`).

    Method `sl1-relaxation` chooses among the same alternatives by convex relaxation and rounding.
    It leaves out alternatives that start and goal rule out by distance alone, and gives no bound.
    The spec's time limit is that of formulation and search together.

    Args:
        scene: The climb.
        margins: Tightening of the statement; None for no tightening.
        save_model: File for the mixed-integer program; None for no file.
        previous: Postures of the same scene with smaller margins. Their bound holds here too, and
            their choices are the initial solution.
        nodes: Largest number of nodes of the built-in branch and bound.
        explain: Whether infeasibility is explained, which takes as long as a search.

    Raises:
        NoPostures: The convex statement is infeasible; names round, limb and constraint if
            `explain`.
        Unresolved: Method `sl1-relaxation` found no plan.
        LimitReached: The search ended without an incumbent.
    """
    start_time = time.monotonic()
    reject_nonconvex(scene)
    options = scene.spec.solver
    is_relaxation = options.method == "sl1-relaxation"
    if is_relaxation and scene.by_round is None:
        scene = replace(scene, by_round=find_usable_surfaces(scene))
    if previous is None:
        _log_size(scene)
    program = build_posture_program(scene, margins)
    instance = program.instantiate()
    if save_model is not None:
        from climbplan.solvers.model_file import save_model as write_model

        write_model(instance, save_model)
    remaining = max(options.time_limit - (time.monotonic() - start_time), 0.0)
    warm_start = None if previous is None else previous.warm_start
    solver = options.method if is_relaxation else options.posture_solver
    result = solve(instance, solver, options.gap, remaining, warm_start, nodes)
    if result.x is None and is_relaxation:
        message = f"no postures found by method {options.method}: {result.log[-1]}"
        reason = "alternatives are chosen by rounding and not revised"
        raise Unresolved(message, because=reason, stage="posture")
    if result.status == "infeasible":
        if not explain:
            raise NoPostures("no posture sequence found under the given bounds", [])
        raise explain_infeasible(scene, program, instance)
    if result.x is None or result.assignment is None or result.objective is None:
        raise _build_limit_failure(result, options.time_limit, remaining, nodes)
    return _build_result(scene, program, result, is_relaxation)


def _build_limit_failure(
    result: SolverResult, time_limit: float, remaining: float, nodes: float
) -> LimitReached:
    """Build the error of a search that a limit of nodes, time or memory ended."""
    limit = f"within {time_limit:g} s (solver.time_limit)"
    if result.nodes >= nodes:
        limit = f"within {nodes:g} nodes of the search"
    elif result.time < 0.9 * remaining:
        limit = "within the memory for open nodes"
    return LimitReached(
        f"no postures found {limit}, after {result.nodes} nodes; a larger limit, fewer rounds "
        "or fewer regions may help",
        stage="posture",
    )


def _build_result(
    scene: ClimbScene, program: Program, result: SolverResult, is_relaxation: bool
) -> PostureResult:
    """Build the result of a search with an incumbent; a relaxation proves no bound."""
    assert result.objective is not None
    assert result.assignment is not None
    rounds = extract_rounds(scene, program, result)
    return PostureResult(
        rounds=rounds,
        status="optimal" if result.status == "optimal" else "feasible",
        objective=result.objective,
        bound=None if is_relaxation else result.bound,
        gap=None if is_relaxation else result.gap,
        nodes=result.nodes,
        solver=result.solver,
        sizes={**program.counts(), **({} if is_relaxation else {"bound_holds_for": BOUND_SCOPE})},
        notes=note_large_rotations(scene, rounds),
        warm_start=KnownResult(result.assignment, result.bound),
    )


def _log_size(scene: ClimbScene) -> None:
    """Log the size of a large problem before it is built and solved."""
    m, n = scene.spec.task.round_count, scene.robot.limb_count
    alternatives = sum(
        len(region_indices) for per_limb in scene.alternatives for region_indices in per_limb
    )
    if alternatives >= _MIN_REPORTED_ALTERNATIVES:
        regions = len(scene.terrain.regions)
        _log.info(
            "%-9s %d regions x %d limbs x %d rounds: %d choices among %d alternatives",
            *("posture", regions, n, m, m * n, alternatives),
            extra={"note": True},
        )


def reject_nonconvex(scene: ClimbScene) -> None:
    """Raise UsageError for nonconvex requirements: curved terrain, lower step bounds."""
    steps = scene.spec.posture.steps
    if scene.terrain.is_curved:
        raise UsageError("method micp needs flat contact regions: use --method nlp in a tube")
    if steps.com_min > 0 or steps.toe_min > 0:
        raise UsageError(
            "method micp cannot hold lower bounds on steps (com_min, toe_min): they are not "
            "convex; use --method nlp"
        )


def extract_rounds(scene: ClimbScene, program: Program, result: SolverResult) -> Rounds:
    """Return the postures of a solution vector, with toes projected exactly onto their regions."""
    assert result.x is not None
    assert result.assignment is not None
    m, n = scene.spec.task.round_count, scene.robot.limb_count
    toes = np.concatenate([scene.start.toes[None], program.value("toe", result.x)])
    region = np.empty((m + 1, n), np.int64)
    region[0] = scene.start.region
    chosen = result.assignment[: m * n].reshape(m, n)
    alternatives = scene.alternatives
    for j, limb in np.ndindex(m, n):
        region[j + 1, limb] = alternatives[j][limb][chosen[j, limb]]
    for j in range(1, m + 1):
        for limb in range(n):
            toes[j, limb] = scene.terrain.surfaces[region[j, limb]].project(toes[j, limb])
    return Rounds(
        com=_prepend_start(scene.start.com, program.value("com", result.x)),
        rpy=_prepend_start(scene.start.rpy, program.value("rpy", result.x)),
        toes=toes,
        region=region,
    )


def _prepend_start(start: Array, following: Array) -> Array:
    """Return an array with the start's entry in front."""
    return np.concatenate([start[None], following])


def note_large_rotations(scene: ClimbScene, rounds: Rounds) -> tuple[str, ...]:
    """Return a note if a round's rotation leaves the range of the linearisation."""
    level = LinearisedRotation.from_scene(scene).level
    largest = np.abs(rounds.rpy - level).max(axis=1)
    beyond = np.flatnonzero(largest > LINEAR_ROTATION_LIMIT)
    if len(beyond) == 0:
        return ()
    j = int(np.argmax(largest))
    text = (
        f"the body turns {np.rad2deg(largest[j]):.1f} deg in round {j}: the linearised rotation "
        "of method micp holds below about 15 deg; reach and clearance were checked exactly"
    )
    return (text,)
