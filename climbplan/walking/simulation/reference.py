"""Where body and toes are to be at any time of a walk, from the samples of its plan."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from climbplan.arrays import Array, BoolArray
from climbplan.robots.rotations import rotation_world_body
from climbplan.walking.plan.walk_plan import WalkPlan
from climbplan.walking.task.task import ANGLES


@dataclass(frozen=True)
class Swing:
    """A leg's way through the air."""

    start: float  # [s]
    end: float  # [s]
    left: Array  # (3,) where the toe stood [m]
    lands: Array  # (3,) where it will stand [m]
    lift: float  # [m] above the higher of the two

    def at(self, time: float) -> Array:
        """(3,) straight on, lifted as half a sine."""
        share = min(max((time - self.start) / (self.end - self.start), 0.0), 1.0)
        point = (1 - share) * self.left + share * self.lands
        over = max(self.left[2], self.lands[2]) - point[2]
        point[2] += np.sin(np.pi * share) * (self.lift + over)
        return point


@dataclass(frozen=True)
class WalkReference:
    """The plan as functions of time; states go straight from sample to sample."""

    time: Array  # (T,) [s]
    state: Array  # (T, 12)
    rotation: Array  # (T, 3, 3) body to world
    contact: BoolArray  # (T, L)
    stand: Array  # (T, L, 3) where standing toes are [m]
    swings: tuple[tuple[Swing, ...], ...]  # of each leg

    def body(self, sample: int, share: float) -> Array:
        """(12,) the state between two samples."""
        last = min(sample + 1, len(self.time) - 1)
        return np.asarray((1 - share) * self.state[sample] + share * self.state[last])

    def toe(self, leg: int, time: float) -> Array:
        """(3,) where a swinging toe is to be."""
        for swing in self.swings[leg]:
            if time < swing.end:
                return swing.at(time)
        return self.swings[leg][-1].lands


def walk_reference(plan: WalkPlan) -> WalkReference:
    """The reference of a plan, swings put together from where legs stand before and after.

    A leg that swings at the beginning starts where the plan has it; one that never lands again goes
    to its last toe position.
    """
    task, found = plan.task, plan.trajectory
    contact = found.gait.contact.copy()
    contact[-1] = contact[-2]  # flags tell of intervals; the last has none
    time = np.asarray(task.step * np.arange(task.knots + 1), np.float64)
    swings = tuple(
        _swings(time, contact[:, leg], found.toes[:, leg], task.lift)
        for leg in range(task.body.leg_count)
    )
    rotation = np.asarray(rotation_world_body(found.state[:, ANGLES]), np.float64)
    return WalkReference(time, found.state, rotation, contact, found.toes, swings)


def _swings(time: Array, contact: BoolArray, toes: Array, lift: float) -> tuple[Swing, ...]:
    edges = np.flatnonzero(np.diff(np.concatenate([[False], ~contact, [False]]).astype(np.int8)))
    last = len(time) - 1
    found = []
    for first, after in zip(edges[::2].tolist(), edges[1::2].tolist(), strict=True):
        landing = min(after, last)
        left = toes[first - 1] if first else toes[0]
        found.append(Swing(time[first], time[landing] + 1e-9, left, toes[landing], lift))
    return tuple(found)
