"""Postures by nonlinear programming (method `nlp`): exact rotations, curved terrain.

IPOPT is run from several starts (multistart), each with its own contact regions and its own side of
every obstacle. The best plan that passes the exact check is returned. The convex method holds only
for rotations up to about 15 degrees and flat regions. This method takes any yaw, round tubes and
lower bounds on steps, and keeps links off obstacles at every lift and placing. It proves neither
optimality nor infeasibility.

Roll, pitch and, on flat terrain, the yaw relative to the start stay within `rotation_limit_deg`. A
tube is rotationally symmetric, so that the yaw inside one is free.
"""

from __future__ import annotations

import time
from collections.abc import Iterator
from dataclasses import dataclass, replace

from climbplan.climb.plan.climb_plan import Rounds
from climbplan.climb.postures.explanation import DEFAULT_STEPS
from climbplan.climb.postures.nlp.check import Violation, check_postures, compute_posture_cost
from climbplan.climb.postures.nlp.parameters import (
    JOINT_MARGINS,
    Guess,
    build_initial_point,
    build_parameters,
    build_shape,
    build_variable_bounds,
    extract_rounds,
)
from climbplan.climb.postures.nlp.starts import (
    build_convex_guess,
    build_straight_guess,
    find_region_adjacency,
    repin_guess,
)
from climbplan.climb.postures.nlp.statement import compile_posture_nlp
from climbplan.climb.postures.planner import PostureResult
from climbplan.climb.postures.travel_distance import find_excessive_travel
from climbplan.climb.scene.climb_scene import ClimbScene
from climbplan.errors import LimitReached, ReachFailure, Unresolved
from climbplan.progress import Progress
from climbplan.robots.kinematics import require_reachable, to_body
from climbplan.solvers.ipopt.staged_program import CompiledStagedProgram

MAX_ITERATIONS = 150  # per start; those that converge need 5 to 60
# Blocks that the program holds at some instants only
SAMPLED_BLOCKS = ("kinematics.forward", "limbs.axis_collision", "swing.limb_free")
MAX_REFINEMENTS = 4  # of the best plan
MAX_COST_RATIO = 0.999  # factor on the cost that a refinement has to reach
SOLVER = "ipopt (mumps)"


@dataclass(frozen=True)
class NlpRun:
    """The result of one start of the NLP."""

    guess: Guess
    rounds: Rounds
    objective: float  # posture cost [m^2]
    violations: tuple[Violation, ...]  # blocks that do not hold
    iterations: int
    seconds: float

    @property
    def is_accepted(self) -> bool:
        """Return whether every constraint holds by the exact check, whatever IPOPT reported."""
        return not self.violations

    @property
    def worst_violation(self) -> Violation:
        """Return the block with the largest violation."""
        return max(self.violations, key=lambda violation: violation.amount)


def plan_postures_nlp(scene: ClimbScene, report: Progress | None = None) -> PostureResult:
    """Return the best of several locally optimal posture sequences (method `nlp`).

    Starts depend on the spec's seed and on their own index only. The status is "feasible", because
    a local method gives no bound.

    Raises:
        ReachFailure: A limb cannot reach its toe in the start posture.
        Unresolved: The allowed steps cannot cover the distance to the goal, or no start converged.
        LimitReached: The time limit ended the search before all starts were tried.
    """
    options = scene.spec.solver
    deadline = time.monotonic() + options.time_limit
    reject_infeasible(scene)
    attempts: list[NlpRun] = []
    for index, guess in enumerate(generate_guesses(scene, options.starts, deadline)):
        if report is not None:
            report("posture", index / options.starts)
        attempts.append(solve_from(scene, guess, deadline))
        if time.monotonic() > deadline:
            break
    accepted = [attempt for attempt in attempts if attempt.is_accepted]
    if not accepted:
        failure = _describe_failure(scene, attempts)
        if len(attempts) < options.starts:
            raise LimitReached(failure, stage="posture")
        raise Unresolved(failure, because="method nlp is local", stage="posture")
    # Rounded, so that of equally good ones the first is kept whatever the last digits say
    best = min(accepted, key=lambda attempt: round(attempt.objective, 9))
    best = refine_attempt(scene, best, deadline)
    program = compile_posture_nlp(build_shape(scene), MAX_ITERATIONS)
    return PostureResult(
        rounds=best.rounds,
        status="feasible",
        objective=best.objective,
        bound=None,
        gap=None,
        nodes=len(attempts),
        solver=SOLVER,
        sizes=_collect_sizes(program, attempts, best),
        warnings=_collect_warnings(scene, attempts),
    )


def solve_from(scene: ClimbScene, guess: Guess, deadline: float) -> NlpRun:
    """Solve the NLP from one start and check the result exactly.

    Args:
        scene: The climb.
        guess: Initial postures and fixed choices of regions.
        deadline: `time.monotonic` [s] at which IPOPT stops.
    """
    begin = time.monotonic()
    program = compile_posture_nlp(build_shape(scene), MAX_ITERATIONS)
    iterations = 0
    for margin in JOINT_MARGINS:
        variable_box = build_variable_bounds(scene, margin)
        initial_point = build_initial_point(scene, guess, variable_box)
        bounds = replace(program.bounds, lower=variable_box[0], upper=variable_box[1])
        theta = program.formulation.theta(build_parameters(scene, guess))
        solution = program.solver.solve(initial_point, theta, bounds, deadline)
        iterations += solution.iterations
        rounds = extract_rounds(scene, guess, solution.v)
        violations = tuple(v for v in check_postures(scene, rounds) if not v.holds)
        if not violations or any(v.name not in SAMPLED_BLOCKS for v in violations):
            break
        if time.monotonic() > deadline:
            break
        guess = repin_guess(scene, guess, rounds)
    return NlpRun(
        guess=guess,
        rounds=rounds,
        objective=compute_posture_cost(scene, rounds),
        violations=violations,
        iterations=iterations,
        seconds=time.monotonic() - begin,
    )


def refine_attempt(scene: ClimbScene, best: NlpRun, deadline: float) -> NlpRun:
    """Solve the plan again with its fixed choices updated at its own postures, while the cost
    improves.
    """
    if not scene.terrain.obstacles and not scene.terrain.free_choices:
        return best  # nothing but contact regions is fixed
    for _ in range(MAX_REFINEMENTS):
        if time.monotonic() > deadline:
            break
        candidate = solve_from(scene, repin_guess(scene, best.guess, best.rounds), deadline)
        if not candidate.is_accepted or candidate.objective > MAX_COST_RATIO * best.objective:
            break
        best = candidate
    return best


def reject_infeasible(scene: ClimbScene) -> None:
    """Raise an error for infeasibility that needs no solver.

    Raises:
        ReachFailure: A limb of the start posture cannot reach its toe.
        Unresolved: The sum of the largest steps is shorter than the distance to the goal.
    """
    start, spec = scene.start, scene.spec
    toes, first_limb = start.toes.copy(), scene.gait[0]
    require_reachable(scene.robot, to_body(start.com, start.rpy, toes), "start posture")
    normal = scene.terrain.surfaces[start.region[first_limb]].normal_at(toes[first_limb])
    toes[first_limb] += spec.trajectory.swing_clearance * normal  # before the body has moved
    place = f"round 1, {scene.robot.limb_names[first_limb]} lifted"
    require_reachable(scene.robot, to_body(start.com, start.rpy, toes), place)
    for travel in find_excessive_travel(scene):
        without_remedies = replace(
            travel.conflict, remedies=()
        )  # needed at least, perhaps not enough
        raise Unresolved(
            "no posture sequence found", [without_remedies], because=DEFAULT_STEPS, stage="posture"
        )


def generate_guesses(scene: ClimbScene, count: int, deadline: float) -> Iterator[Guess]:
    """Yield `count` starts: the convex plan if it exists, the straight line, random ones."""
    convex_start = build_convex_guess(scene, max(0.5 * (deadline - time.monotonic()), 0.1))
    if convex_start is not None:
        yield convex_start
    remaining = count - (convex_start is not None)
    adjacency = find_region_adjacency(scene) if remaining else ()
    for index in range(remaining):
        yield build_straight_guess(scene, index, 0.0 if index == 0 else 1.0, adjacency)


def _describe_failure(scene: ClimbScene, attempts: list[NlpRun]) -> str:
    """Describe the attempt that came closest, where none was accepted."""
    requested, num_attempts = scene.spec.solver.starts, len(attempts)
    closest = min(attempts, key=lambda attempt: attempt.worst_violation.amount)
    count = (
        f"{requested}"
        if num_attempts == requested
        else f"{num_attempts} (of {requested} asked for)"
    )
    return (
        f"no start of {count} converged: the closest violates {closest.worst_violation}; "
        f"{_describe_goal_error(scene)}more starts, rounds or time may help"
    )


def _describe_goal_error(scene: ClimbScene) -> str:
    """Describe a stated goal posture that is itself out of reach, which is a likely cause of
    failure.
    """
    goal = scene.goal
    try:
        require_reachable(scene.robot, to_body(goal.com, goal.rpy, goal.toes), "goal posture")
    except ReachFailure as failure:
        return f"{failure}; "
    return ""


def _collect_sizes(
    program: CompiledStagedProgram, attempts: list[NlpRun], best: NlpRun
) -> dict[str, object]:
    """Return the sizes of program and search for the plan file."""
    return {
        "variables": program.solver.size,
        "constraints": len(program.bounds.row_lower),
        "starts": len(attempts),
        "accepted": sum(attempt.is_accepted for attempt in attempts),
        "iterations": sum(attempt.iterations for attempt in attempts),
        "best_start": best.guess.label,
    }


def _collect_warnings(scene: ClimbScene, attempts: list[NlpRun]) -> tuple[str, ...]:
    """Return a warning if the time limit left starts untried."""
    untried = scene.spec.solver.starts - len(attempts)
    if untried == 0:
        return ()
    return (f"the time limit left {untried} of {scene.spec.solver.starts} starts untried",)
