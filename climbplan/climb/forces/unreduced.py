"""The force problem as written in chapter 5.1.4, with deflections and torques as variables.

It has 61 variables for six limbs: body deflection (6), forces, wall deflections and torques (18
each), and s = 1 / S_tau. The planner eliminates all but forces. The unreduced form is its oracle in
tests, an alternative in benchmarks, and the family `forces` of exported instances.

Chapter numbers are those of X. Lin (UCLA 2022).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from climbplan.arrays import Array, BoolArray
from climbplan.climb.forces.statement import ForceStatement
from climbplan.mechanics.stiffness import whole_body_stiffness
from climbplan.robots.kinematics import rigid_motion


@dataclass(frozen=True)
class UnreducedProblem:
    """One instant, in SI units and world coordinates."""

    stiffness: Array  # (N, 3, 3) K_i, zero for limbs in the air [N/m]
    body_stiffness: Array  # (6, 6) A
    motion: Array  # (N, 3, 6) B_i = [I P_i^T]
    jacobian: Array  # (N, 3, 3)
    normal: Array  # (N, 3)
    load: Array  # (6,)
    usable_mu: Array  # (N,) mu / S_mu
    max_torque: Array  # (N, 3)
    contact: BoolArray  # (N,)
    max_s: float
    weight: float  # w


def build_unreduced_problems(statement: ForceStatement) -> list[UnreducedProblem]:
    """Return the data of every instant; limbs in the air have no stiffness against a wall."""
    stiffness = np.asarray(np.linalg.inv(statement.compliance), np.float64)
    stiffness = stiffness * statement.contact[..., None, None]
    body = whole_body_stiffness(stiffness, statement.arms)
    motion = rigid_motion(statement.arms)
    return [
        UnreducedProblem(
            stiffness=stiffness[k],
            body_stiffness=body[k],
            motion=motion[k],
            jacobian=statement.jacobian[k],
            normal=statement.normal[k],
            load=statement.load[k],
            usable_mu=statement.usable_mu[k],
            max_torque=statement.max_torque,
            contact=statement.contact[k],
            max_s=float(statement.max_s[k]),
            weight=statement.normal_force_weight,
        )
        for k in range(len(stiffness))
    ]
