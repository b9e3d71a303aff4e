"""The lines that a run prints: one per stage, with its most important figure."""

from __future__ import annotations

import numpy as np

from climbplan.climb.plan.climb_plan import ClimbPlan
from climbplan.robots.gripper import WRIST_JOINTS
from climbplan.robots.joint_units import torque_unit


def format_summary(plan: ClimbPlan) -> tuple[str, ...]:
    """Return head line, posture and force lines as shown on a terminal."""
    robot, rounds, instants = plan.robot, plan.rounds, plan.instants
    surfaces = ", ".join(s.name for s in plan.terrain.surfaces[:4])
    if len(plan.terrain.surfaces) > 4:
        surfaces += f" and {len(plan.terrain.surfaces) - 4} more"
    head = f"{robot.name}, {rounds.count} rounds, {instants.count} instants, surfaces {surfaces}"
    cost = f"cost {plan.objective:.4g}"
    if plan.bound is not None:
        cost += f", bound {plan.bound:.4g}"
    nodes = plan.sizes["posture"]["nodes"]
    seconds = plan.timings
    solved_count = f"{instants.count} of {instants.count}"
    modes = plan.sizes["posture"].get("modes")
    return (
        f"{plan.name:<16} {head}",
        f"{'posture':<9} {plan.status:<9} {seconds['posture']:.2f} s   {cost}, {nodes} nodes",
        *([f"{'modes':<9} {', '.join(modes)}"] if modes else []),
        f"{'force':<9} {solved_count:<9} {seconds['force']:.2f} s   {describe_min_safety(plan)}",
    )


def describe_min_safety(plan: ClimbPlan) -> str:
    """Describe the instant with the smallest torque safety factor and the joint that sets it."""
    robot, instants, forces = plan.robot, plan.instants, plan.forces
    k = int(np.argmin(forces.safety_torque))
    load = np.abs(forces.motor_torques[k]) / robot.max_torque
    prefix = f"least S_tau {forces.safety_torque[k]:.2f}: {instants.label(k, robot.limb_names)}"
    if plan.grips is not None and robot.gripper is not None:
        wrist = np.abs(plan.grips.wrist_torque[k])
        wrist_load = wrist / robot.gripper.wrist_max_torque
        grip = plan.grips.instants.grip[k]
        if robot.gripper.max_force > 0 and (grip / robot.gripper.max_force).max() > max(
            wrist_load.max(), load.max()
        ):
            gripping_limb = int(np.argmax(grip))
            limb_name = robot.limb_names[gripping_limb]
            return f"{prefix}, {limb_name} grips with {grip[gripping_limb]:.1f} N"
        if wrist_load.max() > load.max():
            wrist_limb, wrist_joint = np.unravel_index(int(np.argmax(wrist_load)), wrist_load.shape)
            name = f"{robot.limb_names[wrist_limb]} {WRIST_JOINTS[wrist_joint]}"
            return f"{prefix}, {name} {wrist[wrist_limb, wrist_joint]:.1f} N m"
    limb, joint = np.unravel_index(int(np.argmax(load)), load.shape)
    torque = abs(forces.motor_torques[k, limb, joint])
    name = f"{robot.limb_names[limb]} {robot.joint_name(int(limb), int(joint))}"
    return f"{prefix}, {name} {torque:.1f} {torque_unit(robot, int(limb), int(joint))}"
