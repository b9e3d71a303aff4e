"""Forces and sag of one instant whose commands the limbs can reach.

Commands are linear in forces and body deflection, eq. (4.14), and a limb's outer reach and coxa
bounds are convex, so this is one second-order cone program. The objective is that of the force
problem plus a price on deflection, since commands at the end of a limb's reach would otherwise be
bought for next to nothing.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from climbplan.climb.forces.cones import ConicProgram, instant_cones, selector
from climbplan.climb.forces.statement import ForceStatement
from climbplan.mechanics.friction import project_to_cone
from climbplan.mechanics.stiffness import Deflections, rigid_motion
from climbplan.plans.climb_plan import Array
from climbplan.robots.model import Robot
from climbplan.robots.rotations import rotation_world_body

_DEFLECTION_PRICE = 0.1  # of s, for a metre of deflection: about 2 % of S_tau where it matters


@dataclass(frozen=True)
class Pressing:
    """Forces and the deflections that command them."""

    force: Array  # (..., N, 3) [N]
    deflections: Deflections


@dataclass(frozen=True)
class BodyPose:
    """A pose of the body."""

    com: Array  # (3,) [m]
    rpy: Array  # (3,) [rad]


def replan_within_reach(
    robot: Robot,
    statement: ForceStatement,
    k: int,
    toes: Array,
    poses: Sequence[BodyPose],
    compensated: bool,
    margin: float,
) -> Pressing | None:
    """Forces and deflections of the n limbs in contact at instant k, or None if there are none.

    toes: (N, 3) [m]. Commands stay within reach from every pose, and `margin` [m and rad] inside
    full stretch and coxa bounds. compensated: the body does not sag. Returns forces and wall
    deflections (n, 3).
    """
    cones = instant_cones(statement, k)
    n, limb = cones.contacts, cones.limb
    # Variables: forces in units of the load, body deflection, s, length of all wall deflections,
    # and for each pose and limb a point of the disc inside the circle of the coxa's end
    com, s, length, disc = 3 * n, 3 * n + 6, 3 * n + 7, 3 * n + 8
    program = ConicProgram(disc + 2 * n * len(poses))
    program.forces(cones, s_column=s)
    unit = np.eye(program.size)
    program.below("safety", unit[s : s + 1], np.array([cones.largest_s]))
    if compensated:
        program.zero("sag", unit[com : com + 6], np.zeros(6))

    # Wall deflections C f + B delta_com, as rows on the variables
    compliance = statement.compliance[k, limb]
    motion = rigid_motion(statement.arms[k, limb])
    wall = np.zeros((n, 3, program.size))
    for i in range(n):
        wall[i] = selector(compliance[i] * statement.unit, i, program.size)
        wall[i, :, com : com + 6] = motion[i]
    total = np.concatenate([-unit[length : length + 1], -wall.reshape(3 * n, -1)])
    program.cone("deflection", total, np.zeros(1 + 3 * n))
    for index, pose in enumerate(poses):
        rotation = rotation_world_body(pose.rpy)
        for i in range(n):
            start = rotation.T @ (toes[limb[i]] - pose.com) - robot.shoulder_body[limb[i]]
            command = _Command(start, -rotation.T @ wall[i], disc + 2 * (n * index + i))
            _within_reach(program, robot, int(limb[i]), command, margin)

    cost = np.zeros(program.size)
    cost[: 3 * n] = -statement.normal_force_weight * statement.unit * cones.axes[:, 0].ravel()
    cost[s], cost[length] = 1.0, _DEFLECTION_PRICE
    answer = program.minimise(cost)
    if answer is None:
        return None
    force = statement.unit * answer.x[: 3 * n].reshape(n, 3)
    usable = statement.usable_mu[k, limb] * (1 - 1e-12)
    force = project_to_cone(force, cones.axes[:, 0], usable)
    body = np.zeros(6) if compensated else answer.x[com : com + 6]
    own = np.einsum("nij,nj->ni", compliance, force)
    return Pressing(force, Deflections(own + motion @ body, body))


@dataclass(frozen=True)
class _Command:
    """A commanded toe position start + change x from the shoulder, body frame."""

    start: Array  # (3,) [m]
    change: Array  # (3, size)
    disc: int  # column of its point on the disc


def _within_reach(
    program: ConicProgram, robot: Robot, limb: int, command: _Command, margin: float
) -> None:
    """Keep a command within the limb's outer reach and coxa bounds.

    Points within femur and tibia of the disc inside the circle that the coxa's end describes form
    a convex set. It differs from the true workspace only close to the shoulder, which commands
    move away from.
    """
    coxa, femur, tibia = robot.link_lengths[limb]
    name = f"{limb}.{command.disc}"
    point = np.eye(program.size)[command.disc : command.disc + 2]
    none = np.zeros((1, program.size))
    away = np.concatenate([none, -command.change])
    away[1:3] += point
    bound = np.array([femur + tibia - margin, *command.start])
    program.cone(f"reach.{name}", away, bound)
    program.cone(f"disc.{name}", np.concatenate([none, -point]), np.array([coxa, 0.0, 0.0]))
    low = robot.mount_yaw[limb] + robot.joint_lower[limb, 0] + margin
    high = robot.mount_yaw[limb] + robot.joint_upper[limb, 0] - margin
    if high - low < np.pi:
        sides = np.array([[-np.sin(low), np.cos(low), 0], [np.sin(high), -np.cos(high), 0]])
        program.below(f"coxa.{name}", -sides @ command.change, sides @ command.start)
