"""Limits of `micp`."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from climbplan.walking.schema.solver import WalkSolverSpec


@dataclass(frozen=True)
class MicpLimits:
    """What is stated, and when to stop."""

    seconds: float = 150.0
    gap: float = 0.1
    arm_pieces: int = 1  # at first
    height_pieces: int = 1
    angles: tuple[float, float, float] = (0.035, 0.07, 0.035)  # [rad] half widths of the tube
    spin: tuple[float, float, float] = (0.5, 1.0, 0.5)  # [rad/s]
    clock: Callable[[], float] = time.perf_counter  # `process_time` where others share the machine
    processes: int = 1  # that parts of tubes are bounded by; seconds are of each of them


def limits_of(solver: WalkSolverSpec) -> MicpLimits:
    """The limits that a spec sets."""
    return MicpLimits(
        solver.time_limit,
        solver.gap,
        solver.arm_pieces,
        solver.height_pieces,
        tuple(np.deg2rad(solver.tube.angles_deg).tolist()),
        solver.tube.spin,
    )
