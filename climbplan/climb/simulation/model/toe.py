"""What is simulated at the end of a limb: a small sphere about the planned toe point, or the foot
that it is: a larger sphere, or a plate under the sole of a flat one.
"""

from __future__ import annotations

from climbplan.robots.model import Robot
from climbplan.robots.serial_chain import SerialChain
from climbplan.simulation.attributes import numbers

# Contact forces act on a toe's surface, the planner's at a point. A radius of 2 mm bends SiLVIA's
# limbs by as much as a sag of 0.15 mm, which is in proportion to it.
TOE_RADIUS = 0.0005  # [m]
_THICK = 0.01  # [m] of plates
# A narrow sole tips where contacts give: of weight G at height h on a sole of half width b that
# sinks d, b^2 / d has to be well above h. Contacts of plates are four times as stiff as toes'.
_FIRM = 'solref="0.004 1" solmix="1000"'


def toe_radius(robot: Robot) -> float:
    """How far what touches is from the toe [m]: the radius of its sphere, that of its foot, if it
    has one.

    Plates of flat feet are as much lower than their toes as surfaces of points are.
    """
    if robot.foot is None or robot.foot.sole is not None:
        return TOE_RADIUS
    return robot.foot.radius


def sole_plate(robot: Robot, limb: int) -> str:
    """The shape of a plate under a flat foot, in the frame of its last link, as attributes."""
    sole, chain = robot.sole, robot.mechanism
    assert sole is not None
    assert isinstance(chain, SerialChain)
    axes = sole.axes_zero[limb]
    toe = chain.toe_zero[limb] - chain.joint_zero[limb, -1]
    half = [*sole.half_size, _THICK / 2]
    middle = toe + (_THICK / 2 - TOE_RADIUS) * axes[:, 2]
    return (
        f'type="box" pos="{numbers(middle)}" size="{numbers(half)}"'
        f' xyaxes="{numbers(axes[:, 0])} {numbers(axes[:, 1])}" {_FIRM}'
    )
