"""Commanded toe positions that the limbs can reach.

A toe is commanded beyond its surface by as much as the limb gives way (`wall_deflection`), and a
soft limb may be asked further than it reaches. Where that happens, forces and sag are planned
again for that instant together (`reach`).
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from climbplan.climb.forces.reach import BodyPose, Pressing, replan_within_reach
from climbplan.climb.forces.statement import RESIDUAL_LIMIT, ForceStatement, check_forces
from climbplan.climb.scene import ClimbScene
from climbplan.errors import Conflict, Infeasible
from climbplan.mechanics.stiffness import Deflections, deflections_for_forces
from climbplan.plans.climb_plan import Array, Index, Instants, Mask
from climbplan.robots.kinematics import inverse, to_body

# [m] kept from full stretch and [rad] kept from coxa bounds: a trajectory between instants needs
# some room, and gets it where there is any
_MARGINS = (2e-3, 1e-5)

_STIFFER = (1.2, 1.5, 2.0, 3.0, 5.0, 10.0)  # factors that are tried
_LISTED = 5  # instants described one by one


def press(
    scene: ClimbScene, instants: Instants, statement: ForceStatement, force: Array
) -> Pressing:
    """Deflections for planned forces (K, N, 3), with forces replanned where limbs cannot follow.

    Raises Infeasible where no admissible forces have commands within reach, with the joint
    stiffness that would be enough.
    """
    pressing, failed, too_far = _press(scene, instants, statement, force)
    if failed.any():
        stiffness = _stiffness_needed(scene, instants, statement, force)
        raise _beyond_reach(scene, instants, failed, too_far, stiffness)
    return pressing


def _press(
    scene: ClimbScene, instants: Instants, statement: ForceStatement, force: Array
) -> tuple[Pressing, Mask, Mask]:
    """Deflections, the instants (K,) that have none within reach, and their limbs (K, N)."""
    compensated = scene.spec.force.sag == "compensated"
    planned = deflections_for_forces(
        statement.compliance, statement.arms, force, instants.contact, compensated
    )
    beyond = np.flatnonzero(out_of_reach(scene, instants, planned.wall).any(axis=1))
    if not len(beyond):
        nobody = np.zeros(instants.contact.shape, bool)
        return Pressing(force, planned), nobody[:, 0], nobody
    new_force, wall, com = force.copy(), planned.wall.copy(), planned.com.copy()
    for k in beyond:
        poses = [BodyPose(instants.com[j], instants.rpy[j]) for j in (k, _before(instants)[k])]
        for margin in _MARGINS:
            answer = replan_within_reach(
                scene.robot, statement, int(k), instants.toes[k], poses, compensated, margin
            )
            if answer is not None:
                limb = np.flatnonzero(instants.contact[k])
                new_force[k, limb] = answer.force
                wall[k, limb], com[k] = answer.deflections.wall, answer.deflections.com
                break
    too_far = out_of_reach(scene, instants, wall)
    failed = too_far.any(axis=1) | (check_forces(statement, new_force).worst > RESIDUAL_LIMIT)
    return Pressing(new_force, Deflections(wall, com)), failed, too_far


def _stiffness_needed(
    scene: ClimbScene, instants: Instants, statement: ForceStatement, force: Array
) -> float | None:
    """Least tried factor on all joint stiffnesses with which every instant has commands."""
    for factor in _STIFFER:
        stiffer = replace(statement, compliance=statement.compliance / factor)
        if not _press(scene, instants, stiffer, force)[1].any():
            return factor
    return None


def _beyond_reach(
    scene: ClimbScene,
    instants: Instants,
    failed: Mask,
    too_far: Mask,
    stiffness: float | None,
) -> Infeasible:
    names = scene.robot.limb_names
    remedies = (f"{stiffness:g} times the joint stiffness",) if stiffness else ()
    conflicts = []
    for k in np.flatnonzero(failed)[:_LISTED]:
        limbs = ", ".join(names[i] for i in np.flatnonzero(too_far[k]))
        what = f"the limbs give way so far that toe commands of {limbs} leave their reach"
        where = instants.label(int(k), names)
        conflicts.append(Conflict(where, (what,), remedies, in_words=True))
    return Infeasible(
        f"contact forces exist, but {int(failed.sum())} of {instants.count} instants have no toe "
        "commands within reach that press so hard",
        conflicts,
    )


def out_of_reach(scene: ClimbScene, instants: Instants, wall_deflection: Array) -> Mask:
    """(K, N) limbs in contact whose command no joint angles within bounds reach.

    A command is tried from the body pose of its instant and from the pose before it, since limbs
    press before the body moves.
    """
    pose = np.concatenate([np.arange(instants.count), _before(instants)])
    command = np.tile(instants.toes - wall_deflection, (2, 1, 1))
    toes = to_body(instants.com[pose], instants.rpy[pose], command)
    valid = inverse(scene.robot, toes).valid
    both = valid[: instants.count] & valid[instants.count :]
    return np.asarray(instants.contact & ~both)


def _before(instants: Instants) -> Index:
    """(K,) index of the instant before each; the first is its own."""
    return np.maximum(np.arange(instants.count) - 1, 0)
