"""Comparison of ways to solve the force problems of one climb (`climbplan bench force`)."""

from __future__ import annotations

import statistics
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import TextIO

import numpy as np

from climbplan.arrays import Array
from climbplan.climb.forces.literal import (
    LiteralAnswer,
    LiteralProblem,
    literal_problems,
    solve_cvxpy,
    solve_literal,
)
from climbplan.climb.forces.planner import plan_forces
from climbplan.climb.forces.solving import solve_forces
from climbplan.climb.forces.statement import ForceStatement, objective_of, state_forces
from climbplan.climb.gait import plan_instants
from climbplan.climb.plan.climb_plan import Instants, Rounds
from climbplan.climb.scene import ClimbScene, build_scene
from climbplan.errors import LimitReached, MissingSolver, NoPlanFound
from climbplan.spec.climb.model import ClimbSpec
from climbplan.spec.robots.source import load_robot

# Table 5.1 of the dissertation: 96 problems of 61 variables with four-sided pyramids
PUBLISHED_MS, PUBLISHED_BY = 960.0, "Gurobi, published for an i7-8750H (Table 5.1)"

_GAP, _ROUNDS, _RISE = 1.23, 8, 0.8  # [m], -, [m]
_SHIFT = 0.02  # [m] random shift of each toe in its wall
_TOES = {"F": (0.33, -0.12), "M": (0.0, -0.2), "R": (-0.33, -0.12)}  # y and z by limb row [m]
_DRAWS = 100


@dataclass(frozen=True)
class BenchClimb:
    """The instances: a straight climb between two walls."""

    scene: ClimbScene
    instants: Instants


@dataclass(frozen=True)
class _Row:
    name: str
    ms: float  # for all instants
    objective: Array  # (K,) NaN for instants left out


def bench_climb(seed: int) -> BenchClimb:
    """Eight rounds of SiLVIA straight up between walls, toes shifted at random: 96 instants.

    Shifts are drawn until every instant is within the limbs' reach and has admissible forces.
    """
    rng = np.random.default_rng(seed)
    for _ in range(_DRAWS):
        try:
            scene = _shifted_scene(rng)
            instants = plan_instants(scene, straight_rounds(scene))
            plan_forces(scene, instants, "clarabel")
        except NoPlanFound:
            continue
        return BenchClimb(scene, instants)
    raise LimitReached(f"no feasible bench instance in {_DRAWS} draws of seed {seed}")


def _shifted_scene(rng: np.random.Generator) -> ClimbScene:
    toes = {}
    for name in ("RF", "RM", "RR", "LR", "LM", "LF"):
        side = 1.0 if name[0] == "R" else -1.0
        y, z = np.array(_TOES[name[1]]) + rng.uniform(-_SHIFT, _SHIFT, 2)
        toes[name] = (side * _GAP / 2, float(y), float(z))
    raised = {name: (x, y, z + _RISE) for name, (x, y, z) in toes.items()}
    spec = ClimbSpec.model_validate(
        {
            "kind": "climb",
            "margins": "none",  # as published
            "robot": "silvia",
            "terrain": {
                "friction": 1.0,
                "walls": {"gap": _GAP, "along": (-1.0, 1.0), "up": (-1.0, 2.0)},
            },
            "task": {
                "rounds": _ROUNDS,
                "start": {"com": (0.0, 0.0, 0.0), "toes": toes},
                "goal": {"com": (0.0, 0.0, _RISE), "toes": raised},
            },
        }
    )
    return build_scene(spec, load_robot("silvia"))


def straight_rounds(scene: ClimbScene) -> Rounds:
    """Postures evenly between start and goal, without regard to anything else."""
    share = np.linspace(0.0, 1.0, scene.spec.task.round_count + 1)

    def between(start: Array, goal: Array) -> Array:
        part = share.reshape(-1, *[1] * start.ndim)
        return np.asarray((1 - part) * start + part * goal)

    return Rounds(
        com=between(scene.start.com, scene.goal.com),
        rpy=between(scene.start.rpy, scene.goal.rpy),
        toes=between(scene.start.toes, scene.goal.toes),
        region=np.tile(scene.start.region, (len(share), 1)),
    )


def bench_force(seed: int, quick: bool, out: TextIO) -> None:
    """Print times and optima of four ways to solve the same force problems in the same run.

    Times are medians and include building the problems from the planned instants. quick: fewer
    repeats, and CVXPY on every eighth instant only.
    """
    climb = bench_climb(seed)
    statement = state_forces(climb.scene, climb.instants).as_published()
    facets = climb.scene.spec.force.facets
    count = climb.instants.count
    repeats = 5 if quick else 15

    def ours(solver: str) -> Callable[[], Array]:
        def run() -> Array:
            fresh = state_forces(climb.scene, climb.instants).as_published()
            solved = solve_forces(fresh, solver, facets)
            if len(solved.missing):
                raise LimitReached(f"{solver} left {len(solved.missing)} bench instants unsolved")
            return solved.force

        return run

    rows = [
        _timed(f"climbplan: eliminated, {facets} facets, DAQP", ours("daqp"), repeats, statement),
        _timed("eliminated, exact cones, Clarabel", ours("clarabel"), repeats, statement),
        _timed(
            "literal 61 variables, exact cones, Clarabel",
            lambda: _literal(statement, solve_literal, 1),
            max(3, repeats // 3),
            statement,
        ),
    ]
    stride = 8 if quick else 1
    name = "literal, CVXPY, one call each"
    name += f" ({count // stride} of {count}, scaled)" if quick else ""
    try:
        row = _timed(
            name,
            lambda: _literal(statement, solve_cvxpy, stride),
            1,
            statement,
        )
        rows.append(_Row(name, row.ms * stride, row.objective))
    except MissingSolver as error:
        out.write(f"left out: {error}\n")
    _print(rows, count, out)
    whole = _median(lambda: plan_forces(climb.scene, climb.instants), repeats)
    out.write(f"with commands within bounds, stability and safety factors: {whole:.1f} ms\n")


def _literal(
    statement: ForceStatement,
    solve: Callable[[LiteralProblem], LiteralAnswer | None],
    stride: int,
) -> Array:
    """Forces by a literal form, NaN for the instants left out or without an answer."""
    force = np.full(statement.arms.shape, np.nan)
    for k, problem in enumerate(literal_problems(statement)):
        if k % stride == 0 and (answer := solve(problem)) is not None:
            force[k] = answer.force
    return force


def _median(run: Callable[[], object], repeats: int) -> float:
    """Median time [ms]."""
    times = []
    for _ in range(repeats):
        start = time.perf_counter()
        run()
        times.append(time.perf_counter() - start)
    return 1e3 * statistics.median(times)


def _timed(name: str, run: Callable[[], Array], repeats: int, statement: ForceStatement) -> _Row:
    force = run()  # also warms up
    return _Row(name, _median(run, repeats), objective_of(statement, force))


def _print(rows: list[_Row], count: int, out: TextIO) -> None:
    exact = rows[1].objective
    out.write(f"force planner, {count} instants (one thread)\n")
    out.write(f"{'':<46}{'ms':>9}{'us each':>9}{'ratio':>8}{'objective off by':>18}\n")
    for row in rows:
        off = np.nanmax(np.abs(row.objective / exact - 1))
        out.write(
            f"{row.name:<46}{row.ms:>9.1f}{1e3 * row.ms / count:>9.0f}"
            f"{row.ms / rows[0].ms:>8.1f}{off:>18.1e}\n"
        )
    out.write(f"{PUBLISHED_BY:<46}{PUBLISHED_MS:>9.1f}{1e3 * PUBLISHED_MS / count:>9.0f}\n")
