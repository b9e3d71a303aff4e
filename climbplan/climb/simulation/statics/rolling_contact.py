"""Spherical feet: which points of their last links touch, step by step.

A foot of radius r about the toe's centre touches a surface of normal n at centre - r n. Within a
step the limb ends in the point of its last link that touches there as planned; from one step to the
next another point of the sphere touches. The foot rolls: the place where the limb stands moves by
as much along its surface.
"""

from __future__ import annotations

import numpy as np

from climbplan.arrays import Array, IntArray, spans_of
from climbplan.climb.plan.climb_plan import ClimbPlan
from climbplan.climb.plan.played import sample_instants
from climbplan.climb.simulation.statics.compiling import compiled
from climbplan.climb.simulation.statics.links import _chain
from climbplan.climb.simulation.statics.small_algebra import _times
from climbplan.climb.simulation.statics.surfaces import _onto
from climbplan.climb.simulation.statics.tuples import (
    Body,
    Feet,
    Ground,
    Known,
    Motors,
    Pad,
    Playback,
    Stand,
)
from climbplan.robots.last_link import last_link_body
from climbplan.robots.rotations import rotation_world_body


def contact_ends(plan: ClimbPlan, sample: IntArray, angles: Array, toe_zero: Array) -> Array:
    """(S, N, 3) points of last links that touch, at zero angles, body frame [m].

    Args:
        plan: The plan.
        sample: (S,) samples of the trajectory that steps end at.
        angles: (T, N, J) planned joint angles of all samples, as simulated.
        toe_zero: (N, 3) toes at zero angles, body frame [m].

    Returns:
        An array of no steps (0, N, 3) for robots whose feet are points.
    """
    robot, moving = plan.robot, plan.trajectory
    if robot.foot is None:
        return np.zeros((0, robot.limb_count, 3))
    arm = robot.foot.arm(_normals(plan)[sample])  # (S, N, 3), world
    body = np.einsum("sji,snj->sni", rotation_world_body(moving.rpy[sample]), arm)
    links, links_zero = last_link_body(robot, angles[sample]), last_link_body(robot, 0 * angles[0])
    turned_back = np.einsum("nki,snkj,snj->sni", links_zero, links, body)
    return np.ascontiguousarray(toe_zero + turned_back)


def _normals(plan: ClimbPlan) -> Array:
    """(T, N, 3) normals under toes; in the air those of the nearer end of the swing in time."""
    contact = plan.trajectory.contact
    normal = plan.instants.normal[np.maximum(sample_instants(plan), 0)].copy()
    last = len(normal) - 1
    for limb in range(normal.shape[1]):
        for start, end in spans_of(~contact[:, limb]):
            middle = (start + end) // 2
            if start > 0:
                normal[start:middle, limb] = normal[start - 1, limb]
            normal[middle:end, limb] = normal[min(end, last), limb]
    return normal


@compiled
def _rolled_on(
    plan: Playback,
    s: int,
    body: Body,
    stand: Stand,
    ground: Ground,
    motors: Motors,
    known: Known,
    feet: Feet,
    pad: Pad,
) -> None:
    """Let limbs end in the points that touch in step s, in place."""
    before, after, shift = pad.v[0], pad.v[1], pad.v[2]
    joints = motors.angles.shape[1]
    for i in range(len(motors.angles)):
        _chain(plan.zero[i], motors.angles[i], pad.columns, pad.axes, before)
        for a in range(3):
            plan.zero[i, 2 * joints, a] = plan.ends[s, i, a]
        _chain(plan.zero[i], motors.angles[i], pad.columns, pad.axes, after)
        for a in range(3):
            after[a] -= before[a]
        _times(known.rotation, after, shift)
        if known.stood[i]:
            for a in range(3):
                known.toes[i, a] += shift[a]
        _times(body.rotation, after, shift)
        for a in range(3):
            stand.anchor[i, a] += shift[a]
            feet.set_down[i, a] += shift[a]
        if stand.touching[i]:
            _onto(stand.anchor[i], stand.solid[i], stand.face[i], ground, pad.v[3])
