"""A regulator of the body's pose on top of the plan's commands.

Motors that are stiffer or softer than believed, a payload, or a toe that slid let the body come to
rest elsewhere than planned, and every limb that is then put down starts from there: errors add up.
The regulator integrates the body's departure and tells standing limbs to carry it back: toes are
commanded as if the body had moved by the correction. While a toe takes load or is let go of nothing
new is corrected: pressed with next to nothing, it slides at next to nothing.
"""

from __future__ import annotations

import numpy as np

from climbplan.climb.plan.climb_plan import ClimbPlan
from climbplan.reports.replay import sample_instants, true_angles
from climbplan.robots.kinematics import jacobian_world, toe_world
from climbplan.robots.rotations import Array, rotation_world_body, skew
from climbplan.simulation.odometry import standing

RATE = 1.0  # [1/s] at which a departure is worked off
MOST_SHIFT, MOST_TURN = 0.06, 0.15  # [m], [rad] of corrections, within which they are linear


class Regulator:
    """Integral action on the body's attitude, and on its place if asked."""

    def __init__(self, plan: ClimbPlan, place: bool) -> None:
        moving, robot = plan.trajectory, plan.robot
        angles = true_angles(plan, sample_instants(plan))
        self._place = place
        self._com, self._rpy = moving.com, moving.rpy
        self._contact = moving.contact
        self._jacobian = jacobian_world(robot, moving.rpy, angles)
        self._arms = toe_world(robot, moving.com, moving.rpy, angles) - moving.com[:, None]
        self._settled = (standing(plan) == moving.contact).all(axis=1)  # no toe half loaded
        self.shift, self.turn = np.zeros(3), np.zeros(3)

    def correction(self, sample: float, seconds: float, pose: tuple[Array, Array]) -> Array:
        """(N, 3) what to add to the joint commands [rad].

        sample: of the trajectory, between two of its samples. pose: where the body is, position and
        rotation to the world.
        """
        at = min(int(sample), len(self._com) - 1)
        after, share = min(at + 1, len(self._com) - 1), sample - int(sample)
        com = (1 - share) * self._com[at] + share * self._com[after]
        rpy = (1 - share) * self._rpy[at] + share * self._rpy[after]
        wanted = rotation_world_body(rpy)
        settled = self._settled[at]
        if settled and self._place:
            self.shift = _shortened(self.shift + RATE * seconds * (com - pose[0]), MOST_SHIFT)
        off = wanted @ pose[1].T
        turn = np.array([off[2, 1] - off[1, 2], off[0, 2] - off[2, 0], off[1, 0] - off[0, 1]]) / 2
        if settled:
            self.turn = _shortened(self.turn + RATE * seconds * turn, MOST_TURN)
        # A body that is to move by (shift, turn) sees its toes move the other way.
        moved = -(self.shift + self._arms[at] @ skew(self.turn).T)
        moved = moved * self._contact[at][:, None]
        inverse = np.linalg.pinv(self._jacobian[at], rcond=1e-3)
        return np.asarray(np.einsum("nij,nj->ni", inverse, moved))


def _shortened(vector: Array, most: float) -> Array:
    length = float(np.linalg.norm(vector))
    return vector if length <= most else vector * (most / length)
