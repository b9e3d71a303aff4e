"""Build grippers on spherical wrists as MuJoCo bodies, which welds attach to their holds.

The wrist's joints are those of `robots/gripper.py`: about y of the last link, then about the moved
z, then about the approach direction. A gripper is visible but collides with nothing.
"""

from __future__ import annotations

import numpy as np

from climbplan.robots.gripper import Gripper
from climbplan.robots.joint_dynamics import default_damping
from climbplan.simulation.conditions import Conditions

WRIST_STIFFNESS = (
    20.0  # [N m/rad] of a wrist's servo, which makes its torque by how far it is commanded on
)
_ROTOR = 0.002  # [kg m^2] rotor inertia of a wrist's joint, assumed
_DAMPING = float(default_damping(np.array(WRIST_STIFFNESS), np.array(_ROTOR)))  # [N m s/rad]
_BODY_MASS = 1e-3  # [kg] of each of its bodies: grippers are counted to the body
_INERTIA = 1e-6  # [kg m^2]
_WELD = 'solref="0.004 1" solimp="0.999 0.9999 0.001"'
_AXES = ("1 0 0", "0 -1 0", "0 0 -1")  # where the last link points straight down


def build_gripper(gripper: Gripper, limb: int, radius: float, conditions: Conditions) -> str:
    """Build a wrist and a gripper, with {place} of the wrist's center; radius: visual [m]."""
    rotor = conditions.armature * _ROTOR
    if conditions.armature_value is not None:
        rotor = conditions.armature_value
    lines = []
    for joint, axis in enumerate(_AXES):
        place = "{place}" if joint == 0 else "0 0 0"
        name = f"gripper{limb}" if joint == 2 else f"wrist{joint}limb{limb}"
        low, high = gripper.wrist_lower[joint], gripper.wrist_upper[joint]
        lines.append(
            f'<body name="{name}" pos="{place}"><inertial pos="0 0 0" mass="{_BODY_MASS}"'
            f' diaginertia="{_INERTIA} {_INERTIA} {_INERTIA}"/>'
            f'<joint name="{name_wrist_joint(limb, joint)}" axis="{axis}" armature="{rotor:.9g}"'
            f' range="{low:.6g} {high:.6g}"/>'
        )
    visual = 'mass="0" contype="0" conaffinity="0"'
    length, half_span = gripper.length, gripper.finger_span / 2
    palm = max(length - radius, 0.5 * length)
    lines.append(
        f'<geom name="toe{limb}" type="sphere" size="{radius:.6g}" material="link" {visual}/>'
        f'<geom type="capsule" fromto="0 0 0 0 0 {-palm:.6g}" size="{radius / 2:.6g}"'
        f' material="link" {visual}/>'
        f'<site name="toe{limb}" pos="0 0 0" size="0.001"/>'
    )
    for side in (1, -1):
        lines.append(
            f'<geom type="capsule" fromto="0 0 {-palm:.6g} {side * half_span:.6g} 0 {-length:.6g}"'
            f' size="{radius / 3:.6g}" material="toe" {visual}/>'
        )
    return "".join([*lines, "</body></body></body>"])


def name_wrist_joint(limb: int, joint: int) -> str:
    """Return the name of a wrist's joint and motor."""
    return f"wrist{joint + 1}.{limb}"


def build_wrist_motors(gripper: Gripper, limbs: int, conditions: Conditions) -> list[str]:
    """Build the servos of all wrists, limb by limb."""
    gain, lines = conditions.damping * _DAMPING, []
    if conditions.damping_value is not None:
        gain = conditions.damping_value
    for limb in range(limbs):
        for joint, max_torque in enumerate(np.asarray(gripper.wrist_max_torque)):
            name = name_wrist_joint(limb, joint)
            lines.append(
                f'<position name="{name}" joint="{name}" kp="{WRIST_STIFFNESS}" kv="{gain:.9g}"'
                f' forcerange="{-max_torque:.9g} {max_torque:.9g}"/>'
            )
    return lines


def name_weld(limb: int) -> str:
    """Return the name of the weld of a limb's gripper."""
    return f"grip{limb}"


def build_welds(limbs: int) -> list[str]:
    """Build inactive welds between the world and each gripper."""
    return [
        f'<weld name="{name_weld(limb)}" body1="world" body2="gripper{limb}" active="false"'
        f" {_WELD}/>"
        for limb in range(limbs)
    ]
