"""The toe that is simulated: a small sphere about the planned toe point, or the foot that it is."""

from __future__ import annotations

from climbplan.robots.model import Robot

# Contact forces act on a toe's surface, the planner's at a point. A radius of 2 mm bends SiLVIA's
# limbs by as much as a sag of 0.15 mm, which is in proportion to it.
TOE_RADIUS = 0.0005  # [m]


def toe_radius(robot: Robot) -> float:
    """Radius of the sphere at the end of each limb [m]: that of its foot, if it has one."""
    return TOE_RADIUS if robot.foot is None else robot.foot.radius
