"""Sequential quadratic programming for forces, footholds and motion of a fixed gait."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from climbplan.arrays import Array
from climbplan.robots.rotations import rotation_world_body
from climbplan.walking.offline.fixed_contact_qp import FixedContactProgram, WalkIterate
from climbplan.walking.offline.footing import build_footing
from climbplan.walking.offline.staged_qp import StagedContactProgram
from climbplan.walking.task.task import POSITION, STATE, VELOCITY, Gait, WalkTask, WalkTrajectory

CONVERGENCE_TOLERANCE = 1e-7  # largest change of a state
COARSE_TOLERANCE = 1e-4  # the same where gaits are only compared
_MIN_STEP = 0.15  # of the damped step, as a fraction
_MAX_STATE = 1e3  # larger states are a diverged rollout


@dataclass(frozen=True)
class GaitAnswer:
    """The outcome of a gait: a trajectory whose states are the true rollout of its forces."""

    trajectory: WalkTrajectory | None  # None if a QP had no solution, or the rollout is wild
    objective: float
    reach_violation: float  # [m] how far a toe leaves its box on the rollout, <= 0 if none does
    iterations: int
    has_converged: bool  # the last QP moved nothing
    predicted: float = np.inf  # objective of the states that the last QP predicts

    @property
    def is_feasible(self) -> bool:
        """True if there is a trajectory within its workspace, up to `REACH_SLACK`."""
        return self.trajectory is not None and self.reach_violation <= REACH_SLACK


REACH_SLACK = 1e-5  # [m]


def solve_gait(
    task: WalkTask,
    gait: Gait,
    start: WalkIterate | None = None,
    iterations: int = 12,
    margin: float = 0.0,
    agreement: float = CONVERGENCE_TOLERANCE,
    *,
    elastic: bool = True,
    ceiling: float = np.inf,
) -> GaitAnswer:
    """Solve a gait by SQP, and roll out its forces on the true dynamics.

    Args:
        task: The task.
        gait: The gait.
        start: The first iterate; None: a guess.
        iterations: Largest number of QPs.
        margin: Distance that toes keep from the faces of their boxes [m].
        agreement: Largest change of a state at which the iterations have converged.
        elastic: Accept workspace violation and too fast joints where a QP is infeasible.
        ceiling: No further QP follows one that predicts a higher objective.

    Returns:
        The trajectory and its violation.
    """
    kind = StagedContactProgram if StagedContactProgram.suits(task) else FixedContactProgram
    program = kind(task, gait, margin)
    iterate = start if start is not None else guess_iterate(task, gait)
    has_converged, num_iterations, step_size, last_change = False, 0, 1.0, np.inf
    for num_iterations in range(1, iterations + 1):
        solution = program.solve_qp(iterate, elastic, any_speed=elastic)
        if solution is None or not np.abs(solution.state).max() < _MAX_STATE:
            return GaitAnswer(None, np.inf, np.inf, num_iterations, False)
        change = float(np.abs(solution.state - iterate.state).max())
        # Steps that do not shrink overshoot: the QP has no curvature of the dynamics.
        step_size = (
            max(step_size / 2, _MIN_STEP)
            if change > 0.8 * last_change
            else min(1.0, 1.4 * step_size)
        )
        last_change = change
        if change < agreement:
            has_converged, iterate = True, solution
            break
        iterate = interpolate_iterates(iterate, solution, step_size)
        if program.compute_cost(solution.state, solution.force) > ceiling:
            break
    trajectory = roll_out(program, iterate)
    if not np.abs(trajectory.state).max() < _MAX_STATE:
        return GaitAnswer(None, np.inf, np.inf, num_iterations, False)
    violation = program.compute_violation(trajectory.state, trajectory.toes)
    cost = program.compute_cost(trajectory.state, trajectory.force)
    predicted = program.compute_cost(iterate.state, trajectory.force)
    return GaitAnswer(trajectory, cost, violation, num_iterations, has_converged, predicted)


def interpolate_iterates(first: WalkIterate, second: WalkIterate, fraction: float) -> WalkIterate:
    """Return the point at a fraction of the way from one iterate to another."""
    if fraction == 1.0:
        return second
    return WalkIterate(
        first.state + fraction * (second.state - first.state),
        first.force + fraction * (second.force - first.force),
        first.spots + fraction * (second.spots - first.spots),
    )


def roll_out(program: FixedContactProgram, iterate: WalkIterate) -> WalkTrajectory:
    """Return the trajectory under the forces and footholds of an iterate."""
    toes = program.compute_toes(iterate.state, iterate.spots)
    state = program.roll_out(toes, iterate.force)
    toes = program.compute_toes(state, iterate.spots)  # swinging ones follow the body
    while program.raise_swing_heights(toes):
        toes = program.compute_toes(state, iterate.spots)
    force = np.concatenate([iterate.force, np.zeros_like(iterate.force[:1])])
    return WalkTrajectory(state, toes, force, program.gait)


def guess_iterate(task: WalkTask, gait: Gait) -> WalkIterate:
    """Return an iterate with an even change of velocity and angles, and feet under the body."""
    state = guess_states(task)
    standing = gait.contact[:-1]
    count = np.maximum(standing.sum(axis=1), 1)
    push = np.diff(state[:, VELOCITY], axis=0) / task.dt
    push[:, 2] = task.body.gravity
    force_per_leg = task.body.mass * push / count[:, None]
    force = np.where(standing[..., None], force_per_leg[:, None, :], 0.0)
    footing = build_footing(gait)
    spots = np.zeros((footing.count, 2))
    for k in range(footing.count):
        stance = state[footing.first[k] : footing.last[k] + 1]
        R = rotation_world_body(stance[:, 6:9])
        centers = stance[:, POSITION] + R @ task.body.toe_center[footing.leg[k]]
        spots[k] = centers[:, :2].mean(axis=0)
    spots = task.ground.project(footing.region, spots)
    return WalkIterate(state, force, spots)


def guess_states(task: WalkTask) -> Array:
    """Return states (N + 1, 12) that change velocity and angles evenly over the first half."""
    knots = task.knots
    state = np.zeros((knots + 1, STATE))
    state[0] = task.start.state
    fraction = np.minimum(np.arange(1, knots + 1) / max(knots / 2, 1.0), 1.0)[:, None]
    start, reference = task.start.state, task.reference
    state[1:, VELOCITY] = start[VELOCITY] + fraction * (reference.velocity - start[VELOCITY])
    state[1:, 6:9] = start[6:9] + fraction * (reference.euler - start[6:9])
    steps = task.dt * 0.5 * (state[:-1, VELOCITY] + state[1:, VELOCITY])
    state[1:, POSITION] = start[POSITION] + np.cumsum(steps, axis=0)
    state[1:, 2] = reference.height
    state[:, 5] = 0.0
    state[0] = start
    return state


def build_iterate(trajectory: WalkTrajectory, gait: Gait) -> WalkIterate:
    """Return an iterate of a gait from a trajectory of another one.

    Legs that stand in both keep their force. A leg that stands in `gait` only takes the mean force
    of that knot's legs, and a foothold below its toe in the trajectory.
    """
    old, new = trajectory.gait.contact[:-1], gait.contact[:-1]
    mean = trajectory.force[:-1].sum(axis=1) / np.maximum(old.sum(axis=1), 1)[:, None]
    force = np.where(old[..., None], trajectory.force[:-1], mean[:, None, :])
    force = np.where(new[..., None], force, 0.0)
    footing = build_footing(gait)
    middle = (footing.first + footing.last) // 2
    stood = trajectory.gait.contact[footing.first, footing.leg]
    knot = np.where(stood, footing.first, middle)
    return WalkIterate(trajectory.state, force, trajectory.toes[knot, footing.leg, :2])
