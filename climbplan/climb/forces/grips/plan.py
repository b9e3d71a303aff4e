"""The grips of a whole plan, as its file stores them."""

from __future__ import annotations

import numpy as np

from climbplan.arrays import BoolArray
from climbplan.climb.forces.grips.planner import compute_pull_margins, compute_wrist_torques
from climbplan.climb.forces.grips.statement import build_grip_statement, compute_grip_wrists
from climbplan.climb.plan.climb_plan import InstantForces, Instants, Trajectory
from climbplan.climb.plan.grips import GripPlan, SpineModel
from climbplan.climb.scene.climb_scene import MotionScene
from climbplan.errors import ReachFailure
from climbplan.mechanics.grip import Grippers, outside_training, split_into_parts
from climbplan.robots.gripper import WRIST_JOINTS

_BOUND_TOLERANCE = 1e-9  # [rad]


def require_wrists(scene: MotionScene, instants: Instants) -> None:
    """Raise ReachFailure where a wrist cannot hold its gripper square on its hold."""
    if scene.grippers is None:
        return
    gripper = scene.grippers.gripper
    angles = compute_grip_wrists(scene, instants, scene.grippers).angles
    bound_violation = np.maximum(gripper.wrist_lower - angles, angles - gripper.wrist_upper)
    if bound_violation.max() <= _BOUND_TOLERANCE:
        return
    k, limb, joint = (
        int(i) for i in np.unravel_index(int(np.argmax(bound_violation)), bound_violation.shape)
    )
    excess_deg = np.rad2deg(bound_violation[k, limb, joint])
    violation_text = f"{WRIST_JOINTS[joint]} {excess_deg:.1f} deg past its bound"
    names = scene.robot.limb_names
    raise ReachFailure(names[limb], violation_text, 0.0, instants.label(k, names))


def find_firm_limbs(grippers: Grippers, instants: Instants) -> BoolArray:
    """Return which limbs (N,) may grip harder than necessary on every hold that they come to.

    A force inside a cone stays inside with any force of the cone added. The force of a finger along
    its axis is such a force where friction holds it on sides so undercut.
    """
    return np.asarray((np.tan(grippers.undercut[instants.region]) <= instants.mu).all(axis=0))


def build_grip_plan(
    scene: MotionScene, instants: Instants, forces: InstantForces, trajectory: Trajectory
) -> GripPlan | None:
    """Return wrist angles, torques and pull-out margins of a plan; None without grippers."""
    grippers = scene.grippers
    if grippers is None or forces.grips is None:
        return None
    if trajectory.grips is None or trajectory.force is None:
        return None
    statement = build_grip_statement(scene, instants, grippers)
    grips = forces.grips
    part_forces = split_into_parts(
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
        wrist_torque=compute_wrist_torques(statement, forces.force, grips.moment),
        pull_margin=compute_pull_margins(statement, part_forces),
        trajectory=trajectory.grips,
        trajectory_force=trajectory.force,
    )


def warn_of_extrapolation(scene: MotionScene, instants: Instants) -> tuple[str, ...]:
    """Return a warning of holds whose orientation or friction the gripper's model was not fitted
    to.
    """
    if scene.grippers is None:
        return ()
    is_extrapolated = outside_training(scene.grippers)
    used_regions = [r for r in np.unique(instants.region) if is_extrapolated[r]]
    if not used_regions:
        return ()
    names = ", ".join(repr(scene.terrain.surfaces[r].name) for r in used_regions[:3])
    ellipsis = f" and {len(used_regions) - 3} more" if len(used_regions) > 3 else ""
    text = (
        f"orientation or friction of {names}{ellipsis} is beyond the grips that the gripper's "
        "model was fitted to: its bound extrapolates"
    )
    return (text,)
