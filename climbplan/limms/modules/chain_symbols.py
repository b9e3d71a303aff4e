"""Symbolic kinematics of a module, eq. (6.2), of which `chain.py` is the numerical version.

Equation numbers are those of X. Lin (UCLA 2022).
"""

from __future__ import annotations

import casadi as ca

from climbplan.limms.modules.chain import ROLLS
from climbplan.limms.schema.module import ModuleSpec


def build_chain_function(module: ModuleSpec) -> ca.Function:
    """Build the kinematics of a module whose first end is at the origin.

    Returns:
        A function of angles (6) and rates (6). Its values are points (3, 8), the rotation of the
            last
        end, and the linear and angular velocity (6) of the last end.
    """
    q = ca.SX.sym("q", 6)
    position, rotation = ca.SX.zeros(3), ca.SX.eye(3)
    points = [position]
    for joint in range(6):
        position = position + module.link_lengths[joint] * rotation[:, 2]
        c, s = ca.cos(q[joint]), ca.sin(q[joint])
        if ROLLS[joint]:
            joint_rotation = ca.vertcat(
                ca.horzcat(c, -s, 0), ca.horzcat(s, c, 0), ca.horzcat(0, 0, 1)
            )
        else:
            joint_rotation = ca.vertcat(
                ca.horzcat(c, 0, s), ca.horzcat(0, 1, 0), ca.horzcat(-s, 0, c)
            )
        rotation = rotation @ joint_rotation
        points.append(position)
    points.append(position + module.link_lengths[6] * rotation[:, 2])
    rate = ca.SX.sym("rate", 6)
    tip_velocity = ca.jtimes(points[-1], q, rate)
    rotation_rate = ca.reshape(ca.jtimes(ca.vec(rotation), q, rate), 3, 3)
    angular_velocity = rotation_rate @ rotation.T
    velocity = ca.vertcat(
        tip_velocity, angular_velocity[2, 1], angular_velocity[0, 2], angular_velocity[1, 0]
    )
    return ca.Function("chain", [q, rate], [ca.horzcat(*points), rotation, velocity])
