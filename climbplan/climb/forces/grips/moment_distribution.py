"""Distribute a missing moment over the forces of palms and fingers."""

from __future__ import annotations

import numpy as np

from climbplan.arrays import Array, BoolArray, IntArray
from climbplan.climb.plan.grips import GripForces
from climbplan.mechanics.equilibrium import grasp_matrix
from climbplan.mechanics.grip import FIRST, SECOND, Grippers, grip_cones, split_into_parts


def distribute_moment(
    grippers: Grippers,
    normal: Array,
    region: IntArray,
    contact: BoolArray,
    *,
    arms: Array,
    force: Array,
    grips: GripForces,
    missing_moment: Array,
    in_line: float,
) -> tuple[Array, GripForces]:
    """Return contact forces (S, N, 3) and grips of S states that add a missing moment (S, 3) [N m].

    Every part of a standing gripper takes a share that grows with what it holds: along its normal
    by its pressure, so that no unpressed part is pulled, and along its surface by friction and
    spines. The added forces have the least sum of squares, relative to what is held, among those
    with that moment and no resultant force (weighted pseudoinverse).

    Args:
        grippers: The grippers on all holds.
        normal: (S, N, 3) normals of the surfaces.
        region: (S, N) numbers of the surfaces.
        contact: (S, N) bool, limb is in contact.
        arms: (S, N, 3) from the body to the grips' centres [m].
        force: (S, N, 3) contact forces [N].
        grips: The grips of these forces.
        missing_moment: (S, 3) moment to add [N m].
        in_line: Singular values that count as zero, relative to the largest.
    """
    axis, span = grippers.axis[region], grippers.gripper.finger_span
    part_forces = split_into_parts(force, grips.grip, grips.moment, grips.palm, axis, span)
    weight_root = _compute_weight_roots(grippers, normal, region, contact, part_forces)
    part_positions = arms[..., None, :] + span / 2 * np.stack([0 * axis, axis, -axis], axis=-2)
    num_states = len(missing_moment)
    grasp = grasp_matrix(part_positions.reshape(num_states, -1, 3)).reshape(num_states, 6, -1, 3)
    weighted = np.einsum("sapi,spij->sapj", grasp, weight_root.reshape(num_states, -1, 3, 3))
    wrench = np.concatenate([np.zeros_like(missing_moment), missing_moment], axis=1)
    inverse = np.linalg.pinv(weighted.reshape(num_states, 6, -1), rcond=in_line)
    added_forces = (inverse @ wrench[..., None]).reshape(part_forces.shape)
    added_forces = (weight_root @ added_forces[..., None])[..., 0]
    finger_difference = added_forces[..., FIRST, :] - added_forces[..., SECOND, :]
    return force + added_forces.sum(axis=-2), GripForces(
        grip=grips.grip + (axis * finger_difference).sum(axis=-1) / 2,
        palm=grips.palm + added_forces[..., 0, :],
        moment=grips.moment + span / 2 * np.cross(axis, finger_difference),
    )


def _compute_weight_roots(
    grippers: Grippers, normal: Array, region: IntArray, contact: BoolArray, part_forces: Array
) -> Array:
    """Return the square roots (S, N, 3, 3, 3) of what each part may add, for forces (S, N, 3, 3).

    Along its normal a part may add as much as it presses, along its surface what it holds by
    friction and spines.
    """
    axis = grippers.axis[region]
    cones = grip_cones(
        normal,
        axis,
        grippers.undercut[region],
        grippers.friction[region],
        grippers.spines[region],
    )
    pressure = np.maximum(cones.pressure(part_forces), 0.0)
    max_shear = cones.mu[..., None] * pressure + cones.spines
    if grippers.gripper.max_force <= 0:
        max_shear[..., FIRST:], pressure[..., FIRST:] = 0.0, 0.0  # fingers stay open
    standing = contact[..., None, None]
    shear_weight, normal_weight = (
        np.sqrt(max_shear)[..., None] * standing,
        np.sqrt(pressure)[..., None] * standing,
    )
    normal_projector = cones.normal[..., None] * cones.normal[..., None, :]
    return np.asarray(
        shear_weight[..., None] * (np.eye(3) - normal_projector)
        + normal_weight[..., None] * normal_projector
    )
