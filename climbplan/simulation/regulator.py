"""A regulator of the body's pose and of the forces between its toes, on top of the plan's commands.

Motors that are stiffer or softer than believed, a payload, a surface a few millimetres beside its
place, or a toe that slid let the body come to rest elsewhere than planned and toes press with other
forces. Each standing limb is told an offset of its toe (world frame), which integrates two errors:

- of the pose: toes are commanded as if the body had moved to where it should be. While a toe takes
  load or is let go of nothing new is corrected: pressed with next to nothing, it slides at next to
  nothing.
- of the forces: how far joints lag behind what they are told, beside how far they should, as a
  deflection d of the toes. Only what toes press against each other counts, d - B A^-1 B^T K d: the
  rest is what a body that has moved does to the forces, and the pose's. A toe that finds no surface
  where it should be is so moved on until it presses; one that found it early gives way.

An offset is a limb's own and begins anew at each touchdown: the place where a toe lands is where it
stands, whatever other limbs were told before. In the air it goes back to zero.
"""

from __future__ import annotations

import numpy as np

from climbplan.climb.plan.climb_plan import ClimbPlan, Mask
from climbplan.mechanics.stiffness import joint_softness, limb_compliance, rigid_motion
from climbplan.reports.replay import sample_instants, true_angles
from climbplan.robots.kinematics import jacobian_world, toe_world
from climbplan.robots.rotations import Array, rotation_world_body, skew
from climbplan.simulation.odometry import standing

RATE = 1.0  # [1/s] at which a departure is worked off
FORCE_RATE = 3.0  # [1/s] at which forces between toes are
BACK = 3.0  # [1/s] at which the offset of a limb in the air goes back to zero
MOST_OFFSET = 0.06  # [m] of a toe, within which offsets are linear
SINGULAR = 1e-3  # of a Jacobian's singular values, below which its inverse knows no motion
STIFFEST = 1e5  # [N/m] that a limb counts for at most


class Regulator:
    """Integral action on the body's attitude and on forces, and on its place if asked."""

    def __init__(self, plan: ClimbPlan, place: bool) -> None:
        moving, robot = plan.trajectory, plan.robot
        angles = true_angles(plan, sample_instants(plan))
        self._place = place
        self._com, self._rpy = moving.com, moving.rpy
        self._contact = moving.contact
        jacobian = jacobian_world(robot, moving.rpy, angles)
        self._turning = np.linalg.pinv(jacobian, rcond=SINGULAR)
        self.arms = toe_world(robot, moving.com, moving.rpy, angles) - moving.com[:, None]
        self._settled = (standing(plan) == moving.contact).all(axis=1)  # no toe half loaded
        self._jacobian = jacobian
        self._most = joint_softness(robot) * robot.max_torque  # [rad] that motors bend joints
        self._bent = np.clip(angles - moving.joint_command, -self._most, self._most)
        self.compliance = limb_compliance(robot, jacobian)
        # Of the toes [m]; at the start, how far they stand off their planned places
        self.offset = np.zeros((robot.limb_count, 3))

    def correction(
        self, sample: float, seconds: float, pose: tuple[Array, Array], lag: Array
    ) -> Array:
        """(N, J) what to add to the joint commands [rad].

        sample: of the trajectory, between two of its samples. pose: where the body is, position and
        rotation to the world. lag: (N, J) how far joints are from what they were last told, less
        what carries the links [rad].
        """
        at = min(int(sample), len(self._com) - 1)
        after, share = min(at + 1, len(self._com) - 1), sample - int(sample)
        stands = self._contact[at]
        planned = (1 - share) * self._bent[at] + share * self._bent[after]
        missing = planned - np.clip(lag, -self._most, self._most)
        deflected = np.einsum("nij,nj->ni", self._jacobian[at], missing)
        sharing = between_toes(self.compliance[at], self.arms[at], stands)
        moved = -FORCE_RATE * (sharing @ deflected.ravel()).reshape(-1, 3)
        if self._settled[at]:
            com = (1 - share) * self._com[at] + share * self._com[after]
            rpy = (1 - share) * self._rpy[at] + share * self._rpy[after]
            off = rotation_world_body(rpy) @ pose[1].T
            turn = np.array([off[2, 1] - off[1, 2], off[0, 2] - off[2, 0], off[1, 0] - off[0, 1]])
            shift = com - pose[0] if self._place else np.zeros(3)
            # A body that is to move by (shift, turn) sees its toes move the other way.
            moved = moved - RATE * (shift + self.arms[at] @ skew(turn / 2).T)
        told = self.offset + seconds * moved
        self.offset = np.where(
            stands[:, None], _shortened(told), self.offset * max(0.0, 1.0 - BACK * seconds)
        )
        return self.told(at)

    def told(self, sample: int) -> Array:
        """(N, J) what offsets add to the joint commands at a sample of the trajectory [rad]."""
        return np.asarray(np.einsum("nij,nj->ni", self._turning[sample], self.offset))


def between_toes(compliance: Array, arms: Array, stands: Mask) -> Array:
    """(..., 3N, 3N) of toe deflections (..., 3N) the part that no motion of the body explains.

    I - B A^-1 B^T K: the motion that balances the forces K d is taken out. compliance: (..., N, 3,
    3) [m/N]; arms: (..., N, 3) from body to toes; stands: (..., N). Of the motions that toes in a
    line leave open the least counts. Toes in the air have no part in it.
    """
    there = stands[..., None, None]
    stiffness = np.linalg.inv(compliance + np.eye(3) / STIFFEST) * there
    motion = rigid_motion(arms) * there
    pulls = np.swapaxes(motion, -1, -2) @ stiffness  # (..., N, 6, 3)
    body = np.linalg.pinv((pulls @ motion).sum(axis=-3), rcond=1e-6, hermitian=True)
    size = 3 * arms.shape[-2]
    taken = np.einsum("...iax,...xy,...jyb->...iajb", motion, body, pulls)
    standing = np.repeat(stands, 3, axis=-1)[..., None]
    return np.asarray(np.eye(size) * standing - taken.reshape(*arms.shape[:-2], size, size))


def _shortened(offset: Array) -> Array:
    """Offsets (N, 3) of at most MOST_OFFSET."""
    length = np.linalg.norm(offset, axis=1, keepdims=True)
    return np.asarray(offset * np.minimum(1.0, MOST_OFFSET / np.maximum(length, 1e-12)))
