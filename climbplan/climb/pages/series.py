"""What figures and page plot over the instants: worst torque and critical friction by limb.

Equation numbers are those of X. Lin (UCLA 2022).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from climbplan.arrays import Array, BoolArray, IntArray
from climbplan.climb.plan.climb_plan import ClimbPlan
from climbplan.robots.joint_units import torque_unit


@dataclass(frozen=True)
class Span:
    """Consecutive instants, both ends included."""

    first: int
    last: int


@dataclass(frozen=True)
class LimbSeries:
    """One limb over the K instants."""

    name: str
    torque: Array  # (K,) |torque| of the joint nearest to its limit [N m]
    joint: IntArray  # (K,) that joint
    joint_names: tuple[str, ...]  # of this limb
    joint_units: tuple[str, ...]  # of their torques: N m, N of joints that slide
    torque_limit: Array  # (K,) max_torque of that joint [N m]
    torque_planned: Array  # (K,) torque_limit / S_tau of the instant [N m]
    mu_critical: Array  # (K,) friction coefficient at which the toe would slip, eq. (5.1)
    mu: Array  # (K,) friction coefficient of the surface
    mu_planned: Array  # (K,) mu / S_mu asked for
    lifted: tuple[Span, ...]  # when the limb is in the air


def find_spans(mask: BoolArray) -> tuple[Span, ...]:
    """Return runs of True in a mask (K,)."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], mask, [False]]).astype(int)))
    return tuple(
        Span(int(first), int(last) - 1) for first, last in zip(edges[::2], edges[1::2], strict=True)
    )


def find_minimum(values: Array) -> int:
    """Return the first instant at which a value is least, to a millionth: a bound holds in many."""
    return int(np.argmax(values <= values.min() + 1e-6 * abs(values.min())))


def compute_limb_series(plan: ClimbPlan) -> tuple[LimbSeries, ...]:
    """Return the series of every limb of a plan."""
    instants, forces = plan.instants, plan.forces
    magnitude = np.abs(forces.motor_torques)  # (K, N, 3)
    limits = np.broadcast_to(plan.robot.max_torque, magnitude.shape)
    worst = np.argmax(magnitude / limits, axis=-1)[..., None]  # (K, N, 1)
    torque = np.take_along_axis(magnitude, worst, axis=-1)[..., 0]
    limit = np.take_along_axis(limits, worst, axis=-1)[..., 0]
    return tuple(
        LimbSeries(
            name=name,
            torque=torque[:, limb],
            joint=worst[:, limb, 0],
            joint_names=plan.robot.limbs.joint_names[limb],
            joint_units=tuple(
                torque_unit(plan.robot, limb, joint) for joint in range(plan.robot.joint_count)
            ),
            torque_limit=limit[:, limb],
            torque_planned=limit[:, limb] / forces.safety_torque,
            mu_critical=forces.mu_critical[:, limb],
            mu=instants.mu[:, limb],
            mu_planned=instants.mu[:, limb] / plan.limits.safety_friction,
            lifted=find_spans(instants.lifted[:, limb]),
        )
        for limb, name in enumerate(plan.robot.limb_names)
    )


def find_round_spans(plan: ClimbPlan) -> tuple[Span, ...]:
    """Return the instants of each round, in order."""
    numbers = plan.instants.round
    starts = np.flatnonzero(np.diff(numbers, prepend=numbers[0] - 1))
    ends = np.append(starts[1:], len(numbers)) - 1
    return tuple(Span(int(a), int(b)) for a, b in zip(starts, ends, strict=True))


def list_instant_labels(plan: ClimbPlan) -> tuple[str, ...]:
    """Return where every instant stands in the gait."""
    names = plan.robot.limb_names
    return tuple(plan.instants.label(k, names) for k in range(plan.instants.count))


def list_drawn_labels(plan: ClimbPlan) -> tuple[str, ...]:
    """Return where every instant stands in the gait, as it may be drawn."""
    from climbplan.reports.sheet import format_limb_name  # loads Matplotlib

    names = tuple(format_limb_name(name) for name in plan.robot.limb_names)
    return tuple(plan.instants.label(k, names) for k in range(plan.instants.count))
