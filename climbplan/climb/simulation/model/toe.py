"""Geometry at the end of a limb: a small sphere at a toe point, a spherical foot, or a plate."""

from __future__ import annotations

from climbplan.robots.model import Robot
from climbplan.robots.serial_chain import SerialChain
from climbplan.simulation.attributes import format_numbers

# Contact forces act on a toe's surface, the planner's at a point. A radius of 2 mm bends SiLVIA's
# limbs by as much as a sag of 0.15 mm, which is in proportion to it.
TOE_RADIUS = 0.0005  # [m]
_PLATE_THICKNESS = 0.01  # [m] of plates
# A narrow sole tips where contacts give: of weight G at height h on a sole of half width b that
# sinks d, b^2 / d has to be well above h. Contacts of plates are four times as stiff as toes'.
_PLATE_SOLVER = 'solref="0.004 1" solmix="1000"'


def compute_toe_radius(robot: Robot) -> float:
    """Compute the distance from the toe to the surface that it touches [m].

    It is the radius of the foot, or of the sphere about a toe point. Plates of flat feet lie lower
    than their toes by the latter.
    """
    if robot.foot is None or robot.foot.sole is not None:
        return TOE_RADIUS
    return robot.foot.radius


def build_sole_plate(robot: Robot, limb: int) -> str:
    """Build the attributes of a plate under a flat foot, in the frame of its last link."""
    sole, chain = robot.sole, robot.mechanism
    assert sole is not None
    assert isinstance(chain, SerialChain)
    axes = sole.axes_zero[limb]
    toe = chain.toe_zero[limb] - chain.joint_zero[limb, -1]
    half_size = [*sole.half_size, _PLATE_THICKNESS / 2]
    center = toe + (_PLATE_THICKNESS / 2 - TOE_RADIUS) * axes[:, 2]
    return (
        f'type="box" pos="{format_numbers(center)}" size="{format_numbers(half_size)}"'
        f' xyaxes="{format_numbers(axes[:, 0])} {format_numbers(axes[:, 1])}" {_PLATE_SOLVER}'
    )
