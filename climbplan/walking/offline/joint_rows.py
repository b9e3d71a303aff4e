"""Torque and speed rows of the fixed-integer QP, for robots with joints."""

from __future__ import annotations

import numpy as np

from climbplan.arrays import Array
from climbplan.robots.walking_legs import WalkingLegs
from climbplan.walking.kernels.joint_speed_rows import (
    NUM_SWING_SAMPLES,
    count_landing_intervals,
    write_speed_rows,
)
from climbplan.walking.kernels.joint_torque_rows import write_torque_rows
from climbplan.walking.kernels.parameters import (
    AffineStates,
    FootholdUnknowns,
    LegChain,
    QpRows,
    SteppingMotion,
)
from climbplan.walking.offline.footing import Footing
from climbplan.walking.task.task import Gait, WalkTask

_TORQUE_FRACTION = 0.999  # of the limits: iterates still move
_SPEED_FRACTION = 0.96  # of the limits: iterates move, and speeds peak between samples


class JointRows:
    """Rows of motor torques and speeds for one gait; none for a body without joints."""

    def __init__(self, task: WalkTask, gait: Gait, footing: Footing) -> None:
        self.task, self.gait, self.footing = task, gait, footing
        self.num_torque_rows = self.num_speed_rows = 0
        if task.legs is not None:
            joints, forces = task.legs.chain.joint_count, int(gait.contact[:-1].sum())
            self.num_torque_rows = 2 * joints * forces  # at both ends of an interval
            self.num_speed_rows = (
                self.num_torque_rows
                + NUM_SWING_SAMPLES * joints * count_landing_intervals(gait.contact)
            )

    def set_task(self, task: WalkTask) -> None:
        """Replace the start, or the length of the first interval; the gait stays."""
        self.task = task

    @property
    def max_rows(self) -> int:
        """Upper bound on the number of rows."""
        return self.num_torque_rows + self.num_speed_rows

    def bound_torques(self, lower: Array, upper: Array) -> None:
        """Write the bounds of torque rows into arrays (max_rows,); linearisations keep them."""
        if self.task.legs is None:
            return
        _, leg = np.nonzero(self.gait.contact[:-1])
        max_torque = _TORQUE_FRACTION * self.task.legs.max_torque[leg]
        upper[: self.num_torque_rows] = np.repeat(max_torque[:, None], 2, axis=1).ravel()
        lower[: self.num_torque_rows] = -upper[: self.num_torque_rows]

    def write_rows(
        self,
        motion: SteppingMotion,
        footholds: FootholdUnknowns,
        states: AffineStates,
        force_unit: float,
        block: QpRows,
    ) -> int:
        """Write rows of torques and of speeds near their limits about a point.

        Args:
            motion: point of linearisation.
            footholds: free footholds.
            states: states by unknowns.
            force_unit: unit of the force unknowns [N].
            block: output, (count, Z).

        Returns:
            The number of rows.
        """
        legs, first = self.task.legs, self.num_torque_rows
        if legs is None:
            return 0
        chains = _build_chains(legs)
        write_torque_rows(
            chains, motion.state, motion.toes, motion.contact, force_unit, block.rows[:first]
        )
        speeds = QpRows(block.rows[first:], block.lower[first:], block.upper[first:])
        max_speed = _SPEED_FRACTION * legs.max_speed
        return first + write_speed_rows(chains, max_speed, motion, footholds, states, speeds)

    def build_motion(self, state: Array, toes: Array) -> SteppingMotion:
        """Return states (N + 1, 12) and toes (N + 1, L, 3) as the gait's motion."""
        task = self.task
        return SteppingMotion(state, toes, self.gait.contact, task.steps, task.swing_clearance)

    def compute_speed_excess(self, state: Array, toes: Array, spots: Array, tilt: Array) -> float:
        """Return the largest excess of a joint speed, as a fraction of its limit.

        It is negative if all joints are within their limits at the samples that rows are for.

        Args:
            state: (N + 1, 12) states.
            toes: (N + 1, L, 3) world frame [m].
            spots: (F, 2) free footholds [m].
            tilt: (F, 2) slope of each foothold's region.
        """
        legs = self.task.legs
        if legs is None:
            return -1.0
        count, unknowns = self.num_speed_rows, spots.size
        block = QpRows(np.zeros((count, unknowns)), np.zeros(count), np.zeros(count))
        written = write_speed_rows(
            _build_chains(legs),
            legs.max_speed,
            self.build_motion(state, toes),
            FootholdUnknowns(self.footing.foothold, spots, tilt, 1.0, 0),
            AffineStates(state, np.zeros((*state.shape, unknowns))),
            block,
        )
        middle = 0.5 * (block.lower + block.upper)[:written]
        fraction = block.rows[:written] @ spots.ravel() - middle
        return float(np.abs(fraction).max(initial=0.0)) - 1.0


def _build_chains(legs: WalkingLegs) -> LegChain:
    """Return the legs' chains as compiled functions take them."""
    chain = legs.chain
    return LegChain(
        chain.joint_zero, chain.axis_zero, chain.slides_zero, chain.drives, chain.toe_zero,
        chain.posture,
    )  # fmt: skip
