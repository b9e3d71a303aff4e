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
from climbplan.climb.postures.nlp.check import Violation, check_postures, posture_cost
from climbplan.climb.postures.nlp.numbers import (
    JOINT_MARGINS,
    Guess,
    first_iterate,
    parameters,
    shape_of,
    to_rounds,
    variable_bounds,
)
from climbplan.climb.postures.nlp.starts import (
    convex_guess,
    meeting_regions,
    repinned,
    straight_guess,
)
from climbplan.climb.postures.nlp.statement import posture_nlp
from climbplan.climb.postures.planner import PostureResult
from climbplan.climb.postures.ways import ways_too_long
from climbplan.climb.scene.climb_scene import ClimbScene
from climbplan.errors import LimitReached, NotProved, ReachFailure
from climbplan.progress import Progress
from climbplan.robots.kinematics import require_reachable, to_body
from climbplan.solvers.ipopt.trajectory import CompiledTrajectory

ITERATIONS = 150  # per start; those that converge need 5 to 60
# Blocks that the program holds at some instants only
BETWEEN = ("kinematics.toes", "limbs.clearance", "swing.limb_free")
REFINEMENTS = 4  # of the best plan
WORTHWHILE = 0.999  # factor on the cost that a refinement has to reach
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
    def accepted(self) -> bool:
        """Whether every constraint holds by the exact check, whatever IPOPT said."""
        return not self.violations

    @property
    def worst(self) -> Violation:
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
    refuse_hopeless(scene)
    attempts: list[Attempt] = []
    for number, guess in enumerate(guesses(scene, options.starts, deadline)):
        if report is not None:
            report("posture", number / options.starts)
        attempts.append(solve_from(scene, guess, deadline))
        if time.monotonic() > deadline:
            break
    accepted = [attempt for attempt in attempts if attempt.accepted]
    if not accepted:
        failure = _failure(scene, attempts)
        if len(attempts) < options.starts:
            raise LimitReached(failure, stage="posture")
        raise NotProved(failure, because="method nlp is local", stage="posture")
    # Rounded, so that of equally good ones the first is kept whatever the last digits say
    best = min(accepted, key=lambda attempt: round(attempt.objective, 9))
    best = refined(scene, best, deadline)
    program = posture_nlp(shape_of(scene), ITERATIONS)
    return PostureResult(
        rounds=best.rounds,
        status="feasible",
        objective=best.objective,
        bound=None,
        gap=None,
        nodes=len(attempts),
        solver=SOLVER,
        sizes=_sizes(program, attempts, best),
        warnings=_warnings(scene, attempts),
    )


def solve_from(scene: ClimbScene, guess: Guess, deadline: float) -> Attempt:
    """IPOPT from one start, and the exact check of what it returns."""
    begin = time.monotonic()
    program = posture_nlp(shape_of(scene), ITERATIONS)
    iterations = 0
    for margin in JOINT_MARGINS:
        box = variable_bounds(scene, margin)
        first = first_iterate(scene, guess, box)
        bounds = replace(program.bounds, lower=box[0], upper=box[1])
        numbers = program.stated.theta(parameters(scene, guess))
        point = program.solver.solve(first, numbers, bounds, deadline)
        iterations += point.iterations
        rounds = to_rounds(scene, guess, point.v)
        violations = tuple(v for v in check_postures(scene, rounds) if not v.holds)
        if not violations or any(v.name not in BETWEEN for v in violations):
            break
        if time.monotonic() > deadline:
            break
        guess = repinned(scene, guess, rounds)
    return Attempt(
        guess=guess,
        rounds=rounds,
        objective=posture_cost(scene, rounds),
        violations=violations,
        iterations=iterations,
        seconds=time.monotonic() - begin,
    )


def refined(scene: ClimbScene, best: Attempt, deadline: float) -> Attempt:
    """The plan solved again with what is pinned chosen anew where it now is, while that helps."""
    if not scene.terrain.obstacles and not scene.terrain.free_choices:
        return best  # nothing but contact regions is pinned
    for _ in range(REFINEMENTS):
        if time.monotonic() > deadline:
            break
        again = solve_from(scene, repinned(scene, best.guess, best.rounds), deadline)
        if not again.accepted or again.objective > WORTHWHILE * best.objective:
            break
        best = again
    return best


def refuse_hopeless(scene: ClimbScene) -> None:
    """What needs no solver to be seen.

    Raises ReachFailure for a start posture beyond a limb's reach, and NotProved where the sum of
    the largest steps is shorter than the way to the goal.
    """
    start, spec = scene.start, scene.spec
    toes, first = start.toes.copy(), scene.gait[0]
    require_reachable(scene.robot, to_body(start.com, start.rpy, toes), "start posture")
    normal = scene.terrain.surfaces[start.region[first]].normal_at(toes[first])
    toes[first] += spec.trajectory.lift * normal  # before the body has moved
    where = f"round 1, {scene.robot.limb_names[first]} lifted"
    require_reachable(scene.robot, to_body(start.com, start.rpy, toes), where)
    for way in ways_too_long(scene):
        bare = replace(way.conflict, remedies=())  # needed at least, perhaps not enough
        raise NotProved("no posture sequence found", [bare], because=DEFAULT_STEPS, stage="posture")


def guesses(scene: ClimbScene, count: int, deadline: float) -> Iterator[Guess]:
    """`count` starts: the convex plan if there is one, the straight way, then random ones."""
    convex = convex_guess(scene, max(0.5 * (deadline - time.monotonic()), 0.1))
    if convex is not None:
        yield convex
    left = count - (convex is not None)
    meeting = meeting_regions(scene) if left else ()
    for index in range(left):
        yield straight_guess(scene, index, 0.0 if index == 0 else 1.0, meeting)


def _failure(scene: ClimbScene, attempts: list[Attempt]) -> str:
    asked, tried = scene.spec.solver.starts, len(attempts)
    closest = min(attempts, key=lambda attempt: attempt.worst.amount)
    count = f"{asked}" if tried == asked else f"{tried} (of {asked} asked for)"
    return (
        f"no start of {count} converged: the closest violates {closest.worst}; "
        f"{_goal_trouble(scene)}more starts, rounds or time may help"
    )


def _goal_trouble(scene: ClimbScene) -> str:
    """What is wrong with the stated goal posture itself, a likely cause within its tolerance."""
    goal = scene.goal
    try:
        require_reachable(scene.robot, to_body(goal.com, goal.rpy, goal.toes), "goal posture")
    except ReachFailure as failure:
        return f"{failure}; "
    return ""


def _sizes(
    program: CompiledTrajectory, attempts: list[Attempt], best: Attempt
) -> dict[str, object]:
    return {
        "variables": program.solver.size,
        "constraints": len(program.bounds.row_lower),
        "starts": len(attempts),
        "accepted": sum(attempt.accepted for attempt in attempts),
        "iterations": sum(attempt.iterations for attempt in attempts),
        "best_start": best.guess.label,
    }


def _warnings(scene: ClimbScene, attempts: list[Attempt]) -> tuple[str, ...]:
    left = scene.spec.solver.starts - len(attempts)
    if left == 0:
        return ()
    return (f"the time limit left {left} of {scene.spec.solver.starts} starts untried",)
