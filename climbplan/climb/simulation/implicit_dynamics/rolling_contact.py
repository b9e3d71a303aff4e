"""Rolling contact of spherical feet: which points of their last links touch, step by step.

A foot of radius r about the toe's centre touches a surface of normal n at centre - r n. Within a
step the limb ends in the point of its last link that touches there as planned. From one step to the
next another point of the sphere touches: the foot rolls, and its contact point moves by the same
distance along the surface.
"""

from __future__ import annotations

import numpy as np

from climbplan.arrays import Array, IntArray, spans_of
from climbplan.climb.plan.climb_plan import ClimbPlan
from climbplan.climb.plan.played import sample_instants
from climbplan.climb.simulation.implicit_dynamics import memory_rows as rows
from climbplan.climb.simulation.implicit_dynamics.compiling import compiled
from climbplan.climb.simulation.implicit_dynamics.limb_kinematics import _compute_kinematics
from climbplan.climb.simulation.implicit_dynamics.linear_algebra import _apply_matrix
from climbplan.climb.simulation.implicit_dynamics.state import (
    PlannedMotion,
    ScratchMemory,
    SimulationState,
    TerrainGeometry,
)
from climbplan.climb.simulation.implicit_dynamics.surfaces import _project_to_surface
from climbplan.robots.last_link import last_link_body
from climbplan.robots.rotations import rotation_world_body


def compute_contact_points(
    plan: ClimbPlan, sample: IntArray, angles: Array, toe_zero: Array
) -> Array:
    """Compute the points of last links that touch, at zero angles, body frame [m].

    Args:
        plan: The plan.
        sample: (S,) samples of the trajectory that steps end at.
        angles: (T, N, J) planned joint angles of all samples, as simulated.
        toe_zero: (N, 3) toes at zero angles, body frame [m].

    Returns:
        (S, N, 3) points [m]; (0, N, 3), no steps, for robots whose feet are points.
    """
    robot, moving = plan.robot, plan.trajectory
    if robot.foot is None:
        return np.zeros((0, robot.limb_count, 3))
    arm = robot.foot.arm(_compute_normals(plan)[sample])  # (S, N, 3), world
    body = np.einsum("sji,snj->sni", rotation_world_body(moving.rpy[sample]), arm)
    links, links_zero = last_link_body(robot, angles[sample]), last_link_body(robot, 0 * angles[0])
    turned_back = np.einsum("nki,snkj,snj->sni", links_zero, links, body)
    return np.ascontiguousarray(toe_zero + turned_back)


def _compute_normals(plan: ClimbPlan) -> Array:
    """Compute normals (T, N, 3) under toes; in the air those of the nearer end of the swing."""
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
def _roll_contacts(
    motion: PlannedMotion,
    s: int,
    ground: TerrainGeometry,
    state: SimulationState,
    work: ScratchMemory,
) -> None:
    """Move the ends of limbs to the points that touch in step s, and the anchors with them."""
    toe_before, toe_after = work.vectors[rows.TOE_BEFORE], work.vectors[rows.TOE]
    shift, normal = work.vectors[rows.SHIFT], work.vectors[rows.SURFACE_NORMAL]
    contacts, motors, regulator = state.contacts, state.motors, state.regulator
    joints = motors.joint_angle.shape[1]
    for i in range(len(motors.joint_angle)):
        _compute_kinematics(
            motion.zero_pose[i], motors.joint_angle[i], work.jacobian, work.joint_axes, toe_before
        )
        for a in range(3):
            motion.zero_pose[i, 2 * joints, a] = motion.contact_points[s, i, a]
        _compute_kinematics(
            motion.zero_pose[i], motors.joint_angle[i], work.jacobian, work.joint_axes, toe_after
        )
        for a in range(3):
            toe_after[a] -= toe_before[a]
        _apply_matrix(regulator.rotation, toe_after, shift)
        if regulator.stood[i]:
            for a in range(3):
                regulator.toes[i, a] += shift[a]
        _apply_matrix(state.body.rotation, toe_after, shift)
        for a in range(3):
            contacts.anchor[i, a] += shift[a]
            state.slip.touchdown[i, a] += shift[a]
        if contacts.in_contact[i]:
            _project_to_surface(
                contacts.anchor[i], contacts.solid[i], contacts.face[i], ground, normal
            )
