"""Postures by nonlinear programming (method `nlp`): exact rotations, curved terrain.

IPOPT from several starts, each with its own contact regions and way round the obstacles; the best
plan that passes the exact check is kept. Where the convex method holds rotations to about 15
degrees and terrain to flat regions, this one takes any yaw, round tubes, and lower bounds on
steps, and keeps the links off obstacles at every lift and placing. It proves neither optimality
nor that no plan exists.

Roll, pitch and, on flat terrain, the yaw since the start stay within `rotation_limit_deg`. In a
tube, which looks the same from all sides, yaw is free and may go all the way round.
"""

from __future__ import annotations

import time
from collections.abc import Iterator
from dataclasses import dataclass, replace

from climbplan.climb.plan.climb_plan import Rounds
from climbplan.climb.postures.explanation import DEFAULT_STEPS
from climbplan.climb.postures.nlp.check import Violation, check_postures, compute_posture_cost
from climbplan.climb.postures.nlp.numbers import (
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
from climbplan.solvers.ipopt.trajectory import CompiledTrajectory

MAX_ITERATIONS = 150  # per start; those that converge need 5 to 60
# Blocks that the program holds at some instants only
SAMPLED_BLOCKS = ("kinematics.toes", "limbs.clearance", "swing.limb_free")
MAX_REFINEMENTS = 4  # of the best plan
MAX_COST_RATIO = 0.999  # factor on the cost that a refinement has to reach
SOLVER = "ipopt (mumps)"


@dataclass(frozen=True)
class Attempt:
    """What became of one start."""

    guess: Guess
    rounds: Rounds
    objective: float  # posture cost [m^2]
    violations: tuple[Violation, ...]  # blocks that do not hold
    iterations: int
    seconds: float

    @property
    def is_accepted(self) -> bool:
        """Whether every constraint holds by the exact check, whatever IPOPT said."""
        return not self.violations

    @property
    def worst_violation(self) -> Violation:
        """The block that fails by most."""
        return max(self.violations, key=lambda violation: violation.amount)


def plan_postures_nlp(scene: ClimbScene, report: Progress | None = None) -> PostureResult:
    """The best of several locally optimal posture sequences (method `nlp`).

    Starts depend on the spec's seed and their own number only. Status is "feasible": a local
    method gives no bound. Raises ReachFailure for a start posture out of reach, Infeasible where
    the steps allowed cannot cover the way to the goal, LimitReached where no start converged.
    """
    options = scene.spec.solver
    deadline = time.monotonic() + options.time_limit
    reject_infeasible(scene)
    attempts: list[Attempt] = []
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


def solve_from(scene: ClimbScene, guess: Guess, deadline: float) -> Attempt:
    """IPOPT from one start, and the exact check of what it returns."""
    begin = time.monotonic()
    program = compile_posture_nlp(build_shape(scene), MAX_ITERATIONS)
    iterations = 0
    for margin in JOINT_MARGINS:
        variable_box = build_variable_bounds(scene, margin)
        initial_point = build_initial_point(scene, guess, variable_box)
        bounds = replace(program.bounds, lower=variable_box[0], upper=variable_box[1])
        theta = program.stated.theta(build_parameters(scene, guess))
        solution = program.solver.solve(initial_point, theta, bounds, deadline)
        iterations += solution.iterations
        rounds = extract_rounds(scene, guess, solution.v)
        violations = tuple(v for v in check_postures(scene, rounds) if not v.holds)
        if not violations or any(v.name not in SAMPLED_BLOCKS for v in violations):
            break
        if time.monotonic() > deadline:
            break
        guess = repin_guess(scene, guess, rounds)
    return Attempt(
        guess=guess,
        rounds=rounds,
        objective=compute_posture_cost(scene, rounds),
        violations=violations,
        iterations=iterations,
        seconds=time.monotonic() - begin,
    )


def refine_attempt(scene: ClimbScene, best: Attempt, deadline: float) -> Attempt:
    """The plan solved again with what is pinned chosen anew where it now is, while that helps."""
    if not scene.terrain.obstacles and not scene.terrain.free_choices:
        return best  # nothing but contact regions is pinned
    for _ in range(MAX_REFINEMENTS):
        if time.monotonic() > deadline:
            break
        candidate = solve_from(scene, repin_guess(scene, best.guess, best.rounds), deadline)
        if not candidate.is_accepted or candidate.objective > MAX_COST_RATIO * best.objective:
            break
        best = candidate
    return best


def reject_infeasible(scene: ClimbScene) -> None:
    """What needs no solver to be seen.

    Raises ReachFailure for a start posture beyond a limb's reach, and NotProved where the sum of
    the largest steps is shorter than the way to the goal.
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
    """`count` starts: the convex plan if there is one, the straight way, then random ones."""
    convex_start = build_convex_guess(scene, max(0.5 * (deadline - time.monotonic()), 0.1))
    if convex_start is not None:
        yield convex_start
    remaining = count - (convex_start is not None)
    adjacency = find_region_adjacency(scene) if remaining else ()
    for index in range(remaining):
        yield build_straight_guess(scene, index, 0.0 if index == 0 else 1.0, adjacency)


def _describe_failure(scene: ClimbScene, attempts: list[Attempt]) -> str:
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
    """What is wrong with the stated goal posture itself, a likely cause within its tolerance."""
    goal = scene.goal
    try:
        require_reachable(scene.robot, to_body(goal.com, goal.rpy, goal.toes), "goal posture")
    except ReachFailure as failure:
        return f"{failure}; "
    return ""


def _collect_sizes(
    program: CompiledTrajectory, attempts: list[Attempt], best: Attempt
) -> dict[str, object]:
    return {
        "variables": program.solver.size,
        "constraints": len(program.bounds.row_lower),
        "starts": len(attempts),
        "accepted": sum(attempt.is_accepted for attempt in attempts),
        "iterations": sum(attempt.iterations for attempt in attempts),
        "best_start": best.guess.label,
    }


def _collect_warnings(scene: ClimbScene, attempts: list[Attempt]) -> tuple[str, ...]:
    untried = scene.spec.solver.starts - len(attempts)
    if untried == 0:
        return ()
    return (f"the time limit left {untried} of {scene.spec.solver.starts} starts untried",)
