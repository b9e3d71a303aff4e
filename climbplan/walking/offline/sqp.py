"""Forces, footholds and motion of a given gait: QPs of the pinned program until they agree."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from climbplan.arrays import Array
from climbplan.robots.rotations import rotation_world_body
from climbplan.walking.offline.footing import footing_of
from climbplan.walking.offline.pinned import Iterate, PinnedProgram
from climbplan.walking.task.task import POSITION, STATE, VELOCITY, Gait, WalkTask, WalkTrajectory

AGREEMENT = 1e-7  # largest change of a state that ends the iterations
ROUGHLY = 1e-4  # and that, where gaits are only compared
_LEAST_SHARE = 0.15  # of a step
_WILD = 1e3  # states beyond are no motion of a robot


@dataclass(frozen=True)
class GaitAnswer:
    """What a gait can do: a trajectory whose states are the true rollout of its forces."""

    trajectory: WalkTrajectory | None  # None if a QP had no solution, or the rollout is wild
    objective: float
    reach: float  # [m] how far a toe leaves its box on the rollout, <= 0 if none does
    iterations: int
    agreed: bool  # the last QP moved nothing
    predicted: float = np.inf  # objective of the states that the last QP predicts

    @property
    def holds(self) -> bool:
        """The trajectory is one, up to `REACH_SLACK`."""
        return self.trajectory is not None and self.reach <= REACH_SLACK


REACH_SLACK = 1e-5  # [m]


def solve_gait(
    task: WalkTask,
    gait: Gait,
    start: Iterate | None = None,
    iterations: int = 12,
    margin: float = 0.0,
    agreement: float = AGREEMENT,
    elastic: bool = True,
    ceiling: float = np.inf,
) -> GaitAnswer:
    """Up to so many QPs from a start (a guess of our own if None), then the true rollout.

    margin: kept inside the workspace boxes [m]; elastic: as of `PinnedProgram.step`, and joints
    may be too fast where nothing else is possible; ceiling: no further QP once one predicts a
    higher objective.
    """
    program = PinnedProgram(task, gait, margin)
    at = start if start is not None else guess(task, gait)
    agreed, done, share, before = False, 0, 1.0, np.inf
    for done in range(1, iterations + 1):
        found = program.step(at, elastic, any_speed=elastic)
        if found is None or not np.abs(found.state).max() < _WILD:
            return GaitAnswer(None, np.inf, np.inf, done, False)
        moved = float(np.abs(found.state - at.state).max())
        # Steps that do not become smaller overshoot: the QP knows no curvature of the dynamics.
        share = max(share / 2, _LEAST_SHARE) if moved > 0.8 * before else min(1.0, 1.4 * share)
        before = moved
        if moved < agreement:
            agreed, at = True, found
            break
        at = between(at, found, share)
        if program.cost(found.state, found.force) > ceiling:
            break
    trajectory = rolled_out(program, at)
    if not np.abs(trajectory.state).max() < _WILD:
        return GaitAnswer(None, np.inf, np.inf, done, False)
    reach = program.reach(trajectory.state, trajectory.toes)
    cost = program.cost(trajectory.state, trajectory.force)
    predicted = program.cost(at.state, trajectory.force)
    return GaitAnswer(trajectory, cost, reach, done, agreed, predicted)


def between(one: Iterate, other: Iterate, share: float) -> Iterate:
    """So far on the way from one iterate to another."""
    if share == 1.0:
        return other
    return Iterate(
        one.state + share * (other.state - one.state),
        one.force + share * (other.force - one.force),
        one.spots + share * (other.spots - one.spots),
    )


def rolled_out(program: PinnedProgram, at: Iterate) -> WalkTrajectory:
    """The trajectory that the forces and footholds of an iterate bring about."""
    toes = program.toes(at.state, at.spots)
    state = program.rolled(toes, at.force)
    toes = program.toes(state, at.spots)  # swinging ones follow the body
    while program.raised(toes):
        toes = program.toes(state, at.spots)
    force = np.concatenate([at.force, np.zeros_like(at.force[:1])])
    return WalkTrajectory(state, toes, force, program.gait)


def guess(task: WalkTask, gait: Gait) -> Iterate:
    """A smooth change of velocity and angles to the reference, feet under the body."""
    state = guessed_states(task)
    standing = gait.contact[:-1]
    count = np.maximum(standing.sum(axis=1), 1)
    push = np.diff(state[:, VELOCITY], axis=0) / task.step
    push[:, 2] = task.body.gravity
    share = task.body.mass * push / count[:, None]
    force = np.where(standing[..., None], share[:, None, :], 0.0)
    footing = footing_of(gait)
    spots = np.zeros((footing.count, 2))
    for k in range(footing.count):
        during = state[footing.first[k] : footing.last[k] + 1]
        R = rotation_world_body(during[:, 6:9])
        under = during[:, POSITION] + R @ task.body.toe_center[footing.leg[k]]
        spots[k] = under[:, :2].mean(axis=0)
    spots = task.ground.into(footing.region, spots)
    return Iterate(state, force, spots)


def guessed_states(task: WalkTask) -> Array:
    """States (N + 1, 12) that change velocity and angles evenly over the first half."""
    knots = task.knots
    state = np.zeros((knots + 1, STATE))
    state[0] = task.start.state
    share = np.minimum(np.arange(1, knots + 1) / max(knots / 2, 1.0), 1.0)[:, None]
    now, reference = task.start.state, task.reference
    state[1:, VELOCITY] = now[VELOCITY] + share * (reference.velocity - now[VELOCITY])
    state[1:, 6:9] = now[6:9] + share * (reference.euler - now[6:9])
    steps = task.step * 0.5 * (state[:-1, VELOCITY] + state[1:, VELOCITY])
    state[1:, POSITION] = now[POSITION] + np.cumsum(steps, axis=0)
    state[1:, 2] = reference.height
    state[:, 5] = 0.0
    state[0] = now
    return state


def iterate_of(trajectory: WalkTrajectory, gait: Gait) -> Iterate:
    """A start for another gait from a trajectory: its states, its forces where both stand.

    A leg that stands in `gait` only takes the mean force of that knot's legs and a foothold where
    its toe is in the trajectory.
    """
    old, new = trajectory.gait.contact[:-1], gait.contact[:-1]
    mean = trajectory.force[:-1].sum(axis=1) / np.maximum(old.sum(axis=1), 1)[:, None]
    force = np.where(old[..., None], trajectory.force[:-1], mean[:, None, :])
    force = np.where(new[..., None], force, 0.0)
    footing = footing_of(gait)
    middle = (footing.first + footing.last) // 2
    stood = trajectory.gait.contact[footing.first, footing.leg]
    knot = np.where(stood, footing.first, middle)
    return Iterate(trajectory.state, force, trajectory.toes[knot, footing.leg, :2])
