"""Limits of the spatial branch and bound."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from climbplan.walking.schema.solver import WalkSolverSpec


@dataclass(frozen=True)
class MicpLimits:
    """Parameters of the relaxation, and when the branch and bound stops."""

    seconds: float = 150.0  # time limit, of each process
    gap: float = 0.1  # relative optimality gap
    arm_pieces: int = 1  # of each moment arm, for piecewise McCormick envelopes
    height_pieces: int = 1  # of the height of the body
    angles: tuple[float, float, float] = (0.035, 0.07, 0.035)  # [rad] half widths of the boxes
    spin: tuple[float, float, float] = (0.5, 1.0, 0.5)  # [rad/s] and of angular velocities
    clock: Callable[[], float] = time.perf_counter  # `process_time` on a shared machine
    processes: int = 1  # that take nodes in parallel


def read_limits(solver: WalkSolverSpec) -> MicpLimits:
    """Return the limits that the solver section of a spec sets."""
    return MicpLimits(
        solver.time_limit,
        solver.gap,
        solver.moment_arm_partitions,
        solver.height_pieces,
        tuple(np.deg2rad(solver.attitude_box.angles_deg).tolist()),
        solver.attitude_box.angular_velocity,
    )
