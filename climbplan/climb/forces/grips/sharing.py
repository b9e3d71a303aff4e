"""What palms and fingers add where a moment is missing."""

from __future__ import annotations

import numpy as np

from climbplan.arrays import Array, BoolArray, IntArray
from climbplan.climb.plan.grips import GripForces
from climbplan.mechanics.equilibrium import grasp_matrix
from climbplan.mechanics.grip import FIRST, SECOND, Grippers, grip_cones, parts_of


def more_of_parts(
    grippers: Grippers,
    normal: Array,
    region: IntArray,
    contact: BoolArray,
    arms: Array,
    force: Array,
    grips: GripForces,
    off: Array,
    in_line: float,
) -> tuple[Array, GripForces]:
    """Contact forces (S, N, 3) and grips of S states that bring a moment off (S, 3) too [N m].

    Every part of a gripper that stands takes a share, the larger the more it holds: along its
    normal by what it presses, so that none is pulled that does not press, and along its surface by
    friction and spines. It is the least sum of squares over what is held that has the moment and no
    force. normal: (S, N, 3) of the surfaces; region: (S, N) theirs; contact: (S, N); arms:
    (S, N, 3) from the body to the grips' centres [m]; in_line: singular values that count as none,
    of the largest.
    """
    axis, span = grippers.axis[region], grippers.gripper.finger_span
    cones = grip_cones(
        normal,
        axis,
        grippers.undercut[region],
        grippers.friction[region],
        grippers.spines[region],
    )
    parts = parts_of(force, grips.grip, grips.moment, grips.palm, axis, span)
    pressure = np.maximum(cones.pressure(parts), 0.0)
    held = cones.mu[..., None] * pressure + cones.spines
    if grippers.gripper.max_force <= 0:
        held[..., FIRST:], pressure[..., FIRST:] = 0.0, 0.0  # fingers stay open
    standing = contact[..., None, None]
    along, onto = np.sqrt(held)[..., None] * standing, np.sqrt(pressure)[..., None] * standing
    places = arms[..., None, :] + span / 2 * np.stack([0 * axis, axis, -axis], axis=-2)

    states = len(off)
    outward = cones.normal[..., None] * cones.normal[..., None, :]
    root = along[..., None] * (np.eye(3) - outward) + onto[..., None] * outward
    grasp = grasp_matrix(places.reshape(states, -1, 3)).reshape(states, 6, -1, 3)
    weighted = np.einsum("sapi,spij->sapj", grasp, root.reshape(states, -1, 3, 3))
    wrench = np.concatenate([np.zeros_like(off), off], axis=1)
    inverse = np.linalg.pinv(weighted.reshape(states, 6, -1), rcond=in_line)
    more = (inverse @ wrench[..., None]).reshape(parts.shape)
    more = (root @ more[..., None])[..., 0]
    apart = more[..., FIRST, :] - more[..., SECOND, :]
    return force + more.sum(axis=-2), GripForces(
        grip=grips.grip + (axis * apart).sum(axis=-1) / 2,
        palm=grips.palm + more[..., 0, :],
        moment=grips.moment + span / 2 * np.cross(axis, apart),
    )
