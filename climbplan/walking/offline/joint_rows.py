"""Rows of the pinned program that only robots with joints have: torques and speeds of motors."""

from __future__ import annotations

import numpy as np

from climbplan.arrays import Array
from climbplan.robots.walking_legs import WalkingLegs
from climbplan.walking.kernels.legs import torque_rows
from climbplan.walking.kernels.speeds import GLANCES, landing_intervals, speed_rows
from climbplan.walking.offline.footing import Footing
from climbplan.walking.task.task import Gait, WalkTask

_TORQUE_IN_HAND = 0.999  # of torque limits, for what iterates still move
_SPEED_IN_HAND = 0.96  # of speed limits, for that and for what is fastest between glances


class JointRows:
    """Torques and speeds of one gait's legs: none of a body without joints."""

    def __init__(self, task: WalkTask, gait: Gait, footing: Footing) -> None:
        self.task, self.gait, self.footing = task, gait, footing
        self.torques = self.speeds = 0
        if task.legs is not None:
            joints, forces = task.legs.chain.joint_count, int(gait.contact[:-1].sum())
            self.torques = 2 * joints * forces  # at both ends of an interval
            self.speeds = self.torques + GLANCES * joints * landing_intervals(gait.contact)

    def begin(self, task: WalkTask) -> None:
        """The same gait from another start, or with a first interval of another length."""
        self.task = task

    @property
    def count(self) -> int:
        """Rows at most."""
        return self.torques + self.speeds

    def bound_torques(self, lower: Array, upper: Array) -> None:
        """What no linearisation changes, into bounds (count,)."""
        if self.task.legs is None:
            return
        _, leg = np.nonzero(self.gait.contact[:-1])
        most = _TORQUE_IN_HAND * self.task.legs.max_torque[leg]
        upper[: self.torques] = np.repeat(most[:, None], 2, axis=1).ravel()
        lower[: self.torques] = -upper[: self.torques]

    def write(
        self, state: Array, toes: Array, spots: Array, tilt: Array, offset: Array, by: Array,
        force_unit: float, foot_unit: float, foot_column: int,
        rows: Array, lower: Array, upper: Array,
    ) -> int:  # fmt: skip
        """Rows (count, Z) about a point, and bounds of speeds; how many of them there are.

        Of speeds, those that are near their limits. Arguments as of `torque_rows`, `speed_rows`.
        """
        task, legs = self.task, self.task.legs
        if legs is None:
            return 0
        cut = self.torques
        torque_rows(
            *_geometry(legs), state, toes, self.gait.contact, force_unit, rows[:cut]
        )  # fmt: skip
        return cut + speed_rows(
            *_geometry(legs), _SPEED_IN_HAND * legs.max_speed, task.steps, task.lift, state, toes,
            self.gait.contact, self.footing.foothold, spots, tilt, offset, by, foot_unit,
            foot_column, rows[cut:], lower[cut:], upper[cut:],
        )  # fmt: skip

    def too_fast(self, state: Array, toes: Array, spots: Array, tilt: Array) -> float:
        """By what share of its limit a joint is beyond it at the glances of rows; below 0 if none.

        Arguments as of `speed_rows`.
        """
        task, legs = self.task, self.task.legs
        if legs is None:
            return -1.0
        count, unknowns = self.speeds, spots.size
        rows, nothing = np.zeros((count, unknowns)), np.zeros((*state.shape, unknowns))
        lower, upper = np.zeros(count), np.zeros(count)
        written = speed_rows(
            *_geometry(legs), legs.max_speed, task.steps, task.lift, state, toes,
            self.gait.contact, self.footing.foothold, spots, tilt, state, nothing, 1.0, 0,
            rows, lower, upper,
        )  # fmt: skip
        share = rows[:written] @ spots.ravel() - 0.5 * (lower + upper)[:written]
        return float(np.abs(share).max(initial=0.0)) - 1.0


def _geometry(legs: WalkingLegs) -> tuple[Array, Array, Array, Array, Array, Array]:
    """Chains as kernels take them."""
    chain = legs.chain
    return (
        chain.joint_zero, chain.axis_zero, chain.slides_zero, chain.drives, chain.toe_zero,
        chain.posture,
    )  # fmt: skip
