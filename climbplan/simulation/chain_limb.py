"""A limb that is a chain of joints, as nested MuJoCo bodies.

At zero angles all links' frames are parallel to the body's, so that every joint is placed by where
it lies beyond the one before and turns about its axis at zero angles.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from climbplan.errors import UsageError
from climbplan.robots.model import Robot
from climbplan.robots.rotations import Array
from climbplan.robots.serial_chain import SerialChain

_SHORTEST = 0.01  # [m] of a link that is drawn and touches
_MASSIVE = 1e-7  # [kg m^2] inertia of a link without length


def chain_of(robot: Robot) -> SerialChain:
    """The chains of a robot that can be simulated; raises UsageError for others."""
    chain = robot.mechanism
    if not isinstance(chain, SerialChain):
        raise UsageError(f"simulate does not know the limbs of {robot.name}")
    if not robot.has_joint.all():
        raise UsageError(
            f"simulate builds limbs of as many joints each; those of {robot.name} have "
            f"{', '.join(str(n) for n in robot.has_joint.sum(axis=1))}"
        )
    return chain


def motor_names(robot: Robot, limb: int) -> list[str]:
    """Names of a limb's joints and motors in the model, from the body to the toe."""
    if robot.mechanism is None:
        return [f"{joint}{limb}" for joint in ("coxa", "femur", "tibia")]
    return [f"joint{j}limb{limb}" for j in range(robot.joint_count)]


def chain_limb(
    robot: Robot,
    limb: int,
    mass: float,
    joints_xml: Sequence[str],
    toe_xml: str,
    narrow: float,
    contype: int,
) -> list[str]:
    """Lines of one limb.

    mass: of each link [kg]. joints_xml: each joint with {name} and {axis}; toe_xml: the toe with
    {place}. narrow: [m] of the last link that touches nothing. contype: collision class of links.
    """
    chain = chain_of(robot)
    points = np.concatenate([chain.joint_zero[limb], chain.toe_zero[limb][None]])
    radius = max(robot.limb_radius, 0.005)
    lines: list[str] = []
    before = np.zeros(3)
    for j, name in enumerate(motor_names(robot, limb)):
        end = points[j + 1] - points[j]
        lines += [
            f'<body name="{name}" pos="{_numbers(points[j] - before)}">',
            joints_xml[j].format(name=name, axis=_numbers(chain.axis_zero[limb, j])),
        ]
        length = float(np.linalg.norm(end))
        if length < _SHORTEST:
            lines.append(
                f'<inertial pos="0 0 0" mass="{mass:.9g}" diaginertia="{_MASSIVE} {_MASSIVE} '
                f'{_MASSIVE}"/>'
            )
        else:
            last = j == robot.joint_count - 1
            part = max(length - narrow, 0.1 * length) / length if last else 1.0
            lines.append(
                f'<geom name="{name}" type="capsule" fromto="0 0 0 {_numbers(part * end)}" '
                f'size="{radius:.6g}" mass="{mass:.9g}" material="link" contype="{contype}" '
                'conaffinity="0"/>'
            )
        before = points[j]
    lines.append(toe_xml.format(place=_numbers(points[-1] - points[-2])))
    return [*lines, "</body>" * robot.joint_count]


def _numbers(values: Array) -> str:
    return " ".join(f"{v:.9g}" for v in np.ravel(values))
