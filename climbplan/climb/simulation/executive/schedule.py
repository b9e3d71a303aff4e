"""What a plan asks of its execution, sample by sample, and where it waits for a measurement.

A gate is a sample that the plan's clock passes only once something has been measured:

- "unload": before a limb hands over its load there must be forces that hold the robot without it;
- "lift": before it leaves its surface it must be unloaded, and toes that stay must hold;
- "touch": before the plan goes on, a limb that ends its swing must have met its surface.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, NamedTuple

import numpy as np

from climbplan.arrays import Array, BoolArray, IntArray, spans_of
from climbplan.climb.plan.climb_plan import ClimbPlan
from climbplan.climb.plan.played import sample_instants
from climbplan.climb.simulation.control.planned_pressure import compute_planned_forces
from climbplan.robots.kinematics import toe_world

_MAX_ASIDE = 5e-3  # [m] off the normal of its place, of a toe that approaches it
_STANDSTILL = 1e-9  # [m], [rad] between two samples of a body that stands still


class Gate(NamedTuple):
    """A sample that the clock passes only once something has been measured."""

    sample: int
    kind: Literal["unload", "lift", "touch"]
    limbs: IntArray


@dataclass(frozen=True)
class MotionSchedule:
    """A plan at each of its T samples, for N limbs."""

    time: Array  # (T,) [s]
    instant: IntArray  # (T,) of the plan, 0 before the first lift
    path: Array  # (T, N, 3) commanded toes [m]
    force: Array  # (T, N, 3) planned forces [N]
    normal: Array  # (T, N, 3) of the surface a toe stands on, or is on its way to
    left_normal: Array  # (T, N, 3) likewise, but of a toe in the air of the one it has left
    mu: Array  # (T, N) friction coefficient of the surface it stands on
    region: IntArray  # (T, N) that surface
    approach: IntArray  # (T, N) at the sample of a touch: the sample from which its toe comes near
    gates: tuple[Gate, ...]  # in the order of time

    def locate(self, clock: float) -> tuple[int, float]:
        """Return the sample at or before a time of the plan [s], and the fraction to the next."""
        index = int(np.searchsorted(self.time, clock + 1e-9, side="right")) - 1
        if index >= len(self.time) - 1:
            return len(self.time) - 1, 0.0
        fraction = (clock - self.time[index]) / (self.time[index + 1] - self.time[index])
        return index, max(float(fraction), 0.0)

    def interpolate(self, values: Array, index: int, fraction: float) -> Array:
        """Interpolate values (T, ...) between a sample and the next."""
        after = min(index + 1, len(values) - 1)
        return np.asarray((1 - fraction) * values[index] + fraction * values[after])


def build_schedule(plan: ClimbPlan, approach_range: float) -> MotionSchedule:
    """Build the schedule of a plan.

    Args:
        plan: The plan.
        approach_range: Height over its place from which on a toe may meet its surface [m].
    """
    robot, trajectory, instants = plan.robot, plan.trajectory, plan.instants
    instant = np.maximum(sample_instants(plan), 0)
    path = toe_world(robot, trajectory.com, trajectory.rpy, trajectory.joint_command)
    left_normal = instants.normal[instant]
    normal = left_normal.copy()
    for limb in range(robot.limb_count):
        for first, last in spans_of(~trajectory.contact[:, limb]):
            if last < len(normal):
                normal[first:last, limb] = normal[last, limb]
    return MotionSchedule(
        time=trajectory.time,
        instant=instant,
        path=path,
        force=compute_planned_forces(plan),
        normal=normal,
        left_normal=left_normal,
        mu=instants.mu[instant],
        region=instants.region[instant],
        approach=_find_approaches(trajectory.contact, path, normal, approach_range),
        gates=_list_gates(trajectory.contact, _find_motion(trajectory.com, trajectory.rpy)),
    )


def _find_motion(com: Array, rpy: Array) -> BoolArray:
    """Find samples (T,) to which the body moves from the one before."""
    step = np.abs(np.diff(np.hstack([com, rpy]), axis=0)).max(axis=1)
    return np.concatenate([[False], step > _STANDSTILL])


def _list_gates(contact: BoolArray, is_moving: BoolArray) -> tuple[Gate, ...]:
    """List the gates of contacts (T, N); a limb is unloaded once the body stands still."""
    gates: list[Gate] = []
    for sample in range(1, len(contact)):
        lifted = np.flatnonzero(contact[sample - 1] & ~contact[sample])
        placed = np.flatnonzero(~contact[sample - 1] & contact[sample])
        if len(lifted):
            first = gates[-1].sample if gates else 0
            motion = np.flatnonzero(is_moving[first : sample - 1])
            steps = int(motion[-1]) if len(motion) else (sample - 1 - first) // 2
            gates += [Gate(first + steps, "unload", lifted), Gate(sample, "lift", lifted)]
        if len(placed):
            gates.append(Gate(sample, "touch", placed))
    return tuple(gates)


def _find_approaches(
    contact: BoolArray, path: Array, normal: Array, approach_range: float
) -> IntArray:
    """Find, at each touch, the sample (T, N) from which on a toe approaches its place."""
    approach = np.zeros(contact.shape, np.int64)
    for limb in range(contact.shape[1]):
        for first, last in spans_of(~contact[:, limb]):
            if last >= len(contact):
                continue
            offset = path[first:last, limb] - path[last, limb]
            height = offset @ normal[last, limb]
            distance = np.linalg.norm(offset - height[:, None] * normal[last, limb], axis=1)
            far = np.flatnonzero((height > approach_range) | (distance > _MAX_ASIDE))
            approach[last, limb] = first + (far[-1] + 1 if len(far) else 0)
    return approach
