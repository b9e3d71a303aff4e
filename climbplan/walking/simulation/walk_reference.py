"""The reference motion of body and toes as functions of time, from the samples of a plan."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from climbplan.arrays import Array, BoolArray
from climbplan.robots.rotations import rotation_world_body
from climbplan.walking.plan.walk_plan import WalkPlan
from climbplan.walking.task.task import ANGLES


@dataclass(frozen=True)
class ToeSwing:
    """The swing trajectory of one toe."""

    start: float  # [s]
    end: float  # [s]
    lift_off: Array  # (3,) [m]
    touchdown: Array  # (3,) [m]
    clearance: float  # [m] above the higher of the two

    def compute_position(self, time: float) -> Array:
        """Return the toe (3,) at a time: straight in the plane, half a sine in height [m]."""
        fraction = min(max((time - self.start) / (self.end - self.start), 0.0), 1.0)
        point = (1 - fraction) * self.lift_off + fraction * self.touchdown
        rise = max(self.lift_off[2], self.touchdown[2]) - point[2]
        point[2] += np.sin(np.pi * fraction) * (self.clearance + rise)
        return point


@dataclass(frozen=True)
class WalkReference:
    """A plan as functions of time; states are interpolated linearly between samples."""

    time: Array  # (T,) [s]
    state: Array  # (T, 12)
    rotation: Array  # (T, 3, 3) body to world
    contact: BoolArray  # (T, L)
    toes: Array  # (T, L, 3) of standing legs [m]
    swings: tuple[tuple[ToeSwing, ...], ...]  # of each leg

    def interpolate_state(self, sample: int, fraction: float) -> Array:
        """Return the state (12,) at a fraction of the interval after a sample."""
        last = min(sample + 1, len(self.time) - 1)
        return np.asarray((1 - fraction) * self.state[sample] + fraction * self.state[last])

    def compute_swing_toe(self, leg: int, time: float) -> Array:
        """Return the reference (3,) of a swinging toe at a time [m]."""
        for swing in self.swings[leg]:
            if time < swing.end:
                return swing.compute_position(time)
        return self.swings[leg][-1].touchdown


def build_walk_reference(plan: WalkPlan) -> WalkReference:
    """Build the reference of a plan; swings connect the footholds before and after.

    A leg in swing at the beginning starts at its planned toe. A leg that never lands again moves
    to its last planned toe.
    """
    task, trajectory = plan.task, plan.trajectory
    contact = trajectory.gait.contact.copy()
    contact[-1] = contact[-2]  # contacts are of intervals; the last knot has none
    time = np.asarray(task.dt * np.arange(task.knots + 1), np.float64)
    swings = tuple(
        _find_swings(time, contact[:, leg], trajectory.toes[:, leg], task.swing_clearance)
        for leg in range(task.body.leg_count)
    )
    rotation = np.asarray(rotation_world_body(trajectory.state[:, ANGLES]), np.float64)
    return WalkReference(time, trajectory.state, rotation, contact, trajectory.toes, swings)


def _find_swings(
    time: Array, contact: BoolArray, toes: Array, clearance: float
) -> tuple[ToeSwing, ...]:
    """Return the swings of one leg from contacts (T,) and toes (T, 3)."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], ~contact, [False]]).astype(np.int8)))
    last = len(time) - 1
    swings = []
    for first, after in zip(edges[::2].tolist(), edges[1::2].tolist(), strict=True):
        landing = min(after, last)
        lift_off = toes[first - 1] if first else toes[0]
        swings.append(
            ToeSwing(time[first], time[landing] + 1e-9, lift_off, toes[landing], clearance)
        )
    return tuple(swings)
