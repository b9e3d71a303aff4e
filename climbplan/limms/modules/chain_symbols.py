"""Kinematics of a module in symbols, eq. (6.2): what `chain.py` does with numbers."""

from __future__ import annotations

import casadi as ca

from climbplan.limms.modules.chain import ROLLS
from climbplan.limms.schema.module import ModuleSpec


def chain_function(module: ModuleSpec) -> ca.Function:
    """Points (3, 8), last rotation, and velocity and spin (6) of a module whose first end is at the
    origin, from angles and rates."""
    q = ca.SX.sym("q", 6)
    position, rotation = ca.SX.zeros(3), ca.SX.eye(3)
    points = [position]
    for joint in range(6):
        position = position + module.link_lengths[joint] * rotation[:, 2]
        c, s = ca.cos(q[joint]), ca.sin(q[joint])
        if ROLLS[joint]:
            turn = ca.vertcat(ca.horzcat(c, -s, 0), ca.horzcat(s, c, 0), ca.horzcat(0, 0, 1))
        else:
            turn = ca.vertcat(ca.horzcat(c, 0, s), ca.horzcat(0, 1, 0), ca.horzcat(-s, 0, c))
        rotation = rotation @ turn
        points.append(position)
    points.append(position + module.link_lengths[6] * rotation[:, 2])
    rate = ca.SX.sym("rate", 6)
    moved = ca.jtimes(points[-1], q, rate)
    turned = ca.reshape(ca.jtimes(ca.vec(rotation), q, rate), 3, 3)
    spin = turned @ rotation.T
    velocity = ca.vertcat(moved, spin[2, 1], spin[0, 2], spin[1, 0])
    return ca.Function("chain", [q, rate], [ca.horzcat(*points), rotation, velocity])
