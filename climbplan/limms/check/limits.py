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
    "samples.rate": Limit(0.01 + 1e-9, "s", "samples at most 10 ms apart, time never runs back"),
    "samples.continuous": Limit(1e-6, "m, rad, m/s", "nothing jumps where modes change"),
    "logic.anchors": Limit(0, "", "each anchor holds one module at most, modes are known"),
    **{f"logic.rule_{n}": Limit(0, "", text) for n, text in RULES.items()},
    "kinematics.points": Limit(1e-6, "m", "stored points are those of the joint angles"),
    "latch.position": Limit(1e-4, "m", "latched ends are in their anchors"),
    "latch.rotation": Limit(1e-4, "rad", "and have the anchors' frames"),
    "latch.dwell": Limit(1e-6, "s", "a latch stays closed for its dwell time"),
    "joint.range": Limit(1e-6, "rad", "joint angles within their ranges"),
    "joint.speed": Limit(1e-4, "rad/s", "joint speeds within their limit"),
    "joint.rates": Limit(0.1, "rad/s", "stored joint velocities are those of the angles"),
    "ground.stand": Limit(1e-4, "m", "standing ends are on the ground, upright"),
    "ground.speed": Limit(
        1e-4, "m/s", "modules that drive keep their speed limit, feet stand still"
    ),
    "ground.free": Limit(0, "", "a free module has an end on the ground or on a box that stands"),
    "clear.solids": Limit(1e-4, "m", "links stay out of what is solid"),
    "clear.boxes": Limit(1e-4, "m", "links stay out of the boxes"),
    "clear.modules": Limit(1e-4, "m", "modules stay out of each other"),
    "clear.self": Limit(1e-4, "m", "links of a module stay out of each other"),
    "clear.box": Limit(1e-4, "m", "the box stays out of solids and other boxes"),
    "box.motion": Limit(
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
    "force.unattached": Limit(
        1e-9, "N", "no force at an anchor without a module, or with a foot in the air"
    ),
    "support.sides": Limit(1e-4, "m", "each foot stands on its own side of the box"),
    "goal.reached": Limit(1e-4, "m", "each box ends at its goal"),
    "goal.turned": Limit(1e-4, "rad", "turned as it is to be, and never where it keeps its yaw"),
    "goal.speed": Limit(1e-4, "m/s, rad/s", "and no faster than it may arrive"),
    "goal.order": Limit(0, "s", "boxes come to their goals in the order of the spec"),
}

# Checks with masses of modules; informational for plans without masses
MASS_LIMITS = {
    "load.balance": Limit(1e-4, "N, N m", "contacts give what box and modules ask for together"),
    "load.force": Limit(1e-4, "N", "forces of box and modules within what a contact holds"),
    "load.moment": Limit(1e-4, "N m", "and their moments within what a latch holds"),
    "load.ground": Limit(1e-4, "N", "ends and boxes that stand push, within the friction cone"),
    "load.tip": Limit(1e-4, "N m", "and what stands does not tip"),
    "load.torque": Limit(1e-4, "N m", "joint torques of box and modules within their limit"),
}


def judge(name: str, residual: float, worst_at: str = "", margin: str = "") -> Check:
    """Return a check by its name in `LIMITS` or `MASS_LIMITS`; NaN never passes."""
    limit = LIMITS[name] if name in LIMITS else MASS_LIMITS[name]
    residual = float(residual) + 0.0
    passed = bool(residual <= limit.value)
    return Check(name, residual, limit.value, limit.unit, passed, margin, worst_at)
