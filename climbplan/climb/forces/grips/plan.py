"""The grips of a whole plan: what its file keeps of them."""

from __future__ import annotations

import numpy as np

from climbplan.arrays import BoolArray
from climbplan.climb.forces.grips.planner import pull_margins, wrist_torques
from climbplan.climb.forces.grips.statement import grip_wrists, state_grips
from climbplan.climb.plan.climb_plan import Forces, Instants, Trajectory
from climbplan.climb.plan.grips import GripPlan, SpineModel
from climbplan.climb.scene.climb_scene import MotionScene
from climbplan.errors import ReachFailure
from climbplan.mechanics.grip import Grippers, outside_training, parts_of
from climbplan.robots.gripper import WRIST_JOINTS

_BOUND_SLACK = 1e-9  # [rad]


def require_wrists(scene: MotionScene, instants: Instants) -> None:
    """Raise ReachFailure where a wrist cannot hold its gripper square on its hold."""
    if scene.grippers is None:
        return
    gripper = scene.grippers.gripper
    angles = grip_wrists(scene, instants, scene.grippers).angles
    beyond = np.maximum(gripper.wrist_lower - angles, angles - gripper.wrist_upper)
    if beyond.max() <= _BOUND_SLACK:
        return
    k, limb, joint = (int(i) for i in np.unravel_index(int(np.argmax(beyond)), beyond.shape))
    over = f"{WRIST_JOINTS[joint]} {np.rad2deg(beyond[k, limb, joint]):.1f} deg past its bound"
    names = scene.robot.limb_names
    raise ReachFailure(names[limb], over, 0.0, instants.label(k, names))


def may_grip_firmly(grippers: Grippers, instants: Instants) -> BoolArray:
    """(N,) limbs whose fingers may grip harder than they must, on every hold that they come to.

    What is within a cone stays there with any force in the cone added: with that of a finger along
    its axis, where friction holds it on sides so undercut.
    """
    return np.asarray((np.tan(grippers.undercut[instants.region]) <= instants.mu).all(axis=0))


def grip_plan(
    scene: MotionScene, instants: Instants, forces: Forces, trajectory: Trajectory
) -> GripPlan | None:
    """Wrist angles, torques and pull-out margins beside the forces; None without grippers."""
    grippers = scene.grippers
    if grippers is None or forces.grips is None:
        return None
    if trajectory.grips is None or trajectory.force is None:
        return None
    statement = state_grips(scene, instants, grippers)
    grips = forces.grips
    parts = parts_of(
        forces.force,
        grips.grip,
        grips.moment,
        grips.palm,
        statement.axis,
        grippers.gripper.finger_span,
    )
    return GripPlan(
        risk=grippers.risk,
        model=SpineModel(**vars(grippers.model)),
        spines=grippers.spines,
        instants=grips,
        wrist_angles=statement.wrists.angles,
        wrist_torque=wrist_torques(statement, forces.force, grips.moment),
        pull_margin=pull_margins(statement, parts),
        trajectory=trajectory.grips,
        trajectory_force=trajectory.force,
    )


def grip_warnings(scene: MotionScene, instants: Instants) -> tuple[str, ...]:
    """Holds in use whose orientation or friction the gripper's model was never fitted to."""
    if scene.grippers is None:
        return ()
    beyond = outside_training(scene.grippers)
    used = [r for r in np.unique(instants.region) if beyond[r]]
    if not used:
        return ()
    names = ", ".join(repr(scene.terrain.surfaces[r].name) for r in used[:3])
    more = f" and {len(used) - 3} more" if len(used) > 3 else ""
    text = (
        f"orientation or friction of {names}{more} is beyond the grips that the gripper's model "
        "was fitted to: its bound extrapolates"
    )
    return (text,)
