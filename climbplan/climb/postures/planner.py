"""First stage: the posture sequence, by global mixed-integer optimisation or by an NLP."""

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
from climbplan.climb.postures.statement import LinearRotation, PostureMargins, posture_program
from climbplan.climb.scene.climb_scene import ClimbScene
from climbplan.climb.scene.within_reach import between
from climbplan.errors import LimitReached, NotProved, UsageError
from climbplan.program import Program
from climbplan.solvers.registry import solve
from climbplan.solvers.result import Known, SolverResult

LINEAR_ROTATION_LIMIT = np.deg2rad(15.0)  # beyond it eq. (5.5) is off by over 3 % about one axis

_MANY = 1000  # alternatives from which a problem's size is told before
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
    warnings: tuple[str, ...]
    known: Known | None = None  # for planning again with wider margins


def plan_postures(
    scene: ClimbScene,
    margins: PostureMargins | None = None,
    save_model: Path | None = None,
    earlier: PostureResult | None = None,
    nodes: float = np.inf,
    explain: bool = True,
) -> PostureResult:
    """Globally optimal postures under linearised rotation (method `micp`).

    Method `sl1-relaxation` chooses among the same alternatives, those left out that start and goal
    rule out by distance alone, by relaxing and rounding; it has no bound, and raises NotProved.
    earlier: postures of the same scene with smaller margins. Their bound holds here too, and their
    choices are tried first. nodes: of the own tree, at most. The spec's time limit is that
    of statement and search together. Raises NoPostures naming round, limb and
    constraint if `explain`, which takes as long as a search, or LimitReached without an incumbent.
    """
    begin = time.monotonic()
    refuse_unsuitable(scene)
    options = scene.spec.solver
    relaxed = options.method == "sl1-relaxation"
    if relaxed and scene.by_round is None:
        scene = replace(scene, by_round=between(scene))
    if earlier is None:
        _tell_size(scene)
    program = posture_program(scene, margins)
    instance = program.at()
    if save_model is not None:
        from climbplan.solvers.model_file import save_model as write_model

        write_model(instance, save_model)
    left = max(options.time_limit - (time.monotonic() - begin), 0.0)
    known = None if earlier is None else earlier.known
    solver = options.method if relaxed else options.posture
    result = solve(instance, solver, options.gap, left, known, nodes)
    if result.x is None and relaxed:
        words = f"{options.method}: no plan, {result.log[-1]}"
        because = "alternatives are settled by rounding and not given up again"
        raise NotProved(words, because=because, stage="posture")
    if result.status == "infeasible":
        if not explain:
            raise NoPostures("no posture sequence found under the given bounds", [])
        raise explain_infeasible(scene, program, instance)
    if result.x is None or result.assignment is None or result.objective is None:
        limit = f"within {options.time_limit:g} s"
        if result.nodes >= nodes:
            limit = f"in the {nodes:g} nodes that the search may take"
        elif result.time < 0.9 * left:
            limit = "in the memory that open nodes may take"
        searched = f"{result.nodes} nodes searched"
        raise LimitReached(f"posture planner: no plan {limit} ({searched})", stage="posture")
    rounds = to_rounds(scene, program, result)
    return PostureResult(
        rounds=rounds,
        status="optimal" if result.status == "optimal" else "feasible",
        objective=result.objective,
        bound=None if relaxed else result.bound,
        gap=None if relaxed else result.gap,
        nodes=result.nodes,
        solver=result.solver,
        sizes={**program.counts(), **({} if relaxed else {"bound_holds_for": BOUND_SCOPE})},
        warnings=rotation_warnings(scene, rounds),
        known=Known(result.assignment, result.bound),
    )


def _tell_size(scene: ClimbScene) -> None:
    """Say how large a large problem is before it is stated and solved."""
    m, n = scene.spec.task.round_count, scene.robot.limb_count
    alternatives = sum(len(own) for each in scene.alternatives for own in each)
    if alternatives >= _MANY:
        regions = len(scene.terrain.regions)
        _log.info(
            "%-9s %d regions x %d limbs x %d rounds: %d choices among %d alternatives",
            *("posture", regions, n, m, m * n, alternatives),
            extra={"note": True},
        )


def refuse_unsuitable(scene: ClimbScene) -> None:
    """UsageError for what a convex statement cannot hold: curved terrain, lower step bounds."""
    steps = scene.spec.posture.steps
    if scene.terrain.curved:
        raise UsageError("method micp needs flat contact regions: use --method nlp in a tube")
    if steps.com_min > 0 or steps.toe_min > 0:
        raise UsageError(
            "method micp cannot hold lower bounds on steps (com_min, toe_min): they are not "
            "convex; use --method nlp"
        )


def to_rounds(scene: ClimbScene, program: Program, result: SolverResult) -> Rounds:
    """Postures from a solution vector, toes put exactly on their regions."""
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
        com=_with_start(scene.start.com, program.value("com", result.x)),
        rpy=_with_start(scene.start.rpy, program.value("rpy", result.x)),
        toes=toes,
        region=region,
    )


def _with_start(start: Array, rest: Array) -> Array:
    return np.concatenate([start[None], rest])


def rotation_warnings(scene: ClimbScene, rounds: Rounds) -> tuple[str, ...]:
    """Rounds whose rotation leaves the range of the linearisation."""
    level = LinearRotation.of(scene).level
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
