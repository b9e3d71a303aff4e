"""Tolerances of the checks of a LIMMS plan."""

from __future__ import annotations

from climbplan.limms.check.logic import RULES
from climbplan.verification.check import Check, Limit

LIMITS = {
    "file.spec_hash": Limit(0, "", "sha256 of the spec's text is the stored one"),
    "file.finite": Limit(0, "", "entries that are NaN, infinite or beyond 1e60"),
    "file.data": Limit(0, "", "values out of their range"),
    "file.spec_values": Limit(
        1e-9, "", "box, goal, modules, friction and free space are those of the spec"
    ),
    "robot.spec": Limit(1e-9, "", "the modules are those that the spec names (relative)"),
    "trajectory.rate": Limit(0.01 + 1e-9, "s", "samples at most 10 ms apart, time never runs back"),
    "trajectory.continuity": Limit(1e-6, "m, rad, m/s", "nothing jumps where modes change"),
    "logic.anchors": Limit(0, "", "each anchor holds one module at most, modes are known"),
    **{f"logic.rule_{n}": Limit(0, "", text) for n, text in RULES.items()},
    "kinematics.forward": Limit(1e-6, "m", "stored points are those of the joint angles"),
    "latch.position": Limit(1e-4, "m", "latched ends are in their anchors"),
    "latch.rotation": Limit(1e-4, "rad", "latched ends have the frames of their anchors"),
    "latch.dwell": Limit(1e-6, "s", "a latch stays closed for its dwell time"),
    "kinematics.joint_bounds": Limit(1e-6, "rad", "joint angles within their ranges"),
    "speed.limit": Limit(1e-4, "rad/s", "joint speeds within their limit"),
    "kinematics.joint_velocity": Limit(
        0.1, "rad/s", "stored joint velocities are those of the angles"
    ),
    "ground.contact": Limit(1e-4, "m", "standing ends are on the ground, upright"),
    "ground.speed": Limit(
        1e-4, "m/s", "modules that drive keep their speed limit, feet stand still"
    ),
    "ground.support": Limit(
        0, "", "a free module has an end on the ground or on a box that stands"
    ),
    "limbs.collision": Limit(1e-4, "m", "links stay out of what is solid"),
    "limbs.box_collision": Limit(1e-4, "m", "links stay out of the boxes"),
    "limbs.module_collision": Limit(1e-4, "m", "modules stay out of each other"),
    "limbs.self_collision": Limit(1e-4, "m", "links of a module stay out of each other"),
    "box.collision": Limit(1e-4, "m", "the box stays out of solids and other boxes"),
    "box.kinematics": Limit(
        1e-4, "m, rad, per s, s^2", "position, yaw, their rates and accelerations belong together"
    ),
    "box.dynamics": Limit(1e-4, "N", "m a = sum of forces + weight, unless the box is stable"),
    "box.stable": Limit(1e-6, "m", "a stable box stands still on the ground"),
    "box.moment": Limit(
        1e-4, "N m", "foot forces of a quadruped turn it as planned, nothing turns a free box"
    ),
    "latch.moment": Limit(1e-4, "N m", "latches hold the moment of an arm's force"),
    "force.limit": Limit(1e-4, "N", "forces within what a contact holds"),
    "force.friction": Limit(1e-4, "N", "foot forces within the friction cone, pushing"),
    "force.without_contact": Limit(
        1e-9, "N", "no force at an anchor without a module, or with a foot in the air"
    ),
    "support.sides": Limit(1e-4, "m", "each foot stands on its own side of the box"),
    "goal.position": Limit(1e-4, "m", "each box ends at its goal"),
    "goal.rotation": Limit(
        1e-4, "rad", "each box has its goal's yaw, and keeps its yaw where it may not turn"
    ),
    "goal.speed": Limit(1e-4, "m/s, rad/s", "each box arrives no faster than it may"),
    "goal.order": Limit(0, "s", "boxes come to their goals in the order of the spec"),
}

# Checks with masses of modules; informational for plans without masses
MASS_LIMITS = {
    "load.balance": Limit(1e-4, "N, N m", "contacts give what box and modules ask for together"),
    "load.force": Limit(1e-4, "N", "forces of box and modules within what a contact holds"),
    "load.moment": Limit(1e-4, "N m", "moments of box and modules within what a latch holds"),
    "load.friction": Limit(1e-4, "N", "ends and boxes that stand push, within the friction cone"),
    "load.tipping": Limit(1e-4, "N m", "what stands on the ground does not tip over"),
    "load.torque": Limit(1e-4, "N m", "joint torques of box and modules within their limit"),
}


def judge(name: str, residual: float, worst_at: str = "", margin: str = "") -> Check:
    """Return a check by its name in `LIMITS` or `MASS_LIMITS`; NaN never passes."""
    limit = LIMITS[name] if name in LIMITS else MASS_LIMITS[name]
    residual = float(residual) + 0.0
    passed = bool(residual <= limit.value)
    return Check(name, residual, limit.value, limit.unit, passed, margin, worst_at)
