"""Where the body is by the joints' own sensors, from toes believed to stay where they stand.

Encoders tell how far motors give way, and so how far the body has sunk between its toes; what the
structure gives beside them goes with it (`structural_compliance_share`) and is taken as known. What
joints play and how far toes slide they do not see. Where a toe stands is what the estimate itself
says once the limb carries load: errors of one foothold go on into the next, but far fewer than
those of a body that nobody looks after.
"""

from __future__ import annotations

import numpy as np

from climbplan.climb.plan.climb_plan import ClimbPlan, Mask
from climbplan.reports.replay import sample_instants
from climbplan.robots.kinematics import toe_body
from climbplan.robots.rotations import Array, rotation_world_body
from climbplan.simulation.planned_pressure import planned_pressure

_STANDS = 0.5  # part of its planned pressure at the next instant from which on a toe stands
_FEWEST = 3  # standing toes that tell a pose


class JointOdometry:
    """The body's pose from joint angles, sample by sample."""

    def __init__(self, plan: ClimbPlan, toes: Array | None = None) -> None:
        """toes: (N, 3) where they stand at the start, as far as the robot knows; as planned."""
        self._robot = plan.robot
        self._stands = standing(plan)
        self._stood = self._stands[0]
        self._toes = (plan.rounds.toes[0] if toes is None else toes).copy()
        self._pose = plan.rounds.com[0].copy(), rotation_world_body(plan.rounds.rpy[0])

    def pose(self, sample: int, angles: Array) -> tuple[Array, Array]:
        """Position and rotation to the world, by angles (N, J) at a sample of the trajectory."""
        body = toe_body(self._robot, angles)
        stands = self._stands[sample]
        known = stands & self._stood
        if known.sum() >= _FEWEST:
            self._pose = fitted(body[known], self._toes[known])
        com, rotation = self._pose
        new = stands & ~known
        self._toes[new] = com + body[new] @ rotation.T
        self._stood = stands
        return self._pose


def standing(plan: ClimbPlan) -> Mask:
    """(T, N) toes on their surfaces and pressed by half of what is planned when the body goes on.

    A toe that touches late slides a little while it takes load; so does one that is let go of.
    """
    instant = np.maximum(sample_instants(plan), 0)
    planned = np.einsum("kni,kni->kn", plan.forces.force, plan.instants.normal)
    following = np.minimum(instant + 1, len(planned) - 1)
    asked = np.minimum(
        np.where(plan.instants.contact[instant], planned[instant], np.inf),
        np.where(plan.instants.contact[following], planned[following], np.inf),
    )
    return plan.trajectory.contact & (planned_pressure(plan) >= _STANDS * asked)


def fitted(points: Array, places: Array) -> tuple[Array, Array]:
    """Translation and rotation that carry points (n, 3) nearest to places (n, 3), least squares.

    Kabsch's method; points in a line leave the turn about it open, and it is then the least.
    """
    middle, there = points.mean(axis=0), places.mean(axis=0)
    left, _, right = np.linalg.svd((points - middle).T @ (places - there))
    hand = np.array([1.0, 1.0, np.linalg.det(right.T @ left.T)])
    rotation = (right.T * hand) @ left.T
    return there - rotation @ middle, rotation
