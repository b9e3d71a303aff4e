"""The result of an MPC run: task, trajectory and what the method says of it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from climbplan.walking.answer import Improvement
from climbplan.walking.task import Array, WalkTask, WalkTrajectory, Whole


@dataclass(frozen=True)
class LoopRecord:
    """What a closed loop adds to its samples; figures of a tick stand at all its samples."""

    push: Array  # (T, 3) [m/s] change of velocity at each sample, which its state contains
    tick_time: Array  # (T,) [s]
    solve_time: Array  # (T,) [s]
    candidates_tried: Whole  # (T,)
    winner: Whole  # (T,) section of the library, or -1 the plan before, -2 a named gait, -3 none
    warnings: tuple[str, ...]  # of ticks, each with its time


STATUSES = ("feasible", "limit")


@dataclass(frozen=True)
class WalkPlan:
    """A run as its plan file keeps it."""

    name: str
    title: str
    method: str
    status: str
    task: WalkTask
    trajectory: WalkTrajectory
    objective: float
    terms: Mapping[str, float]  # of the objective
    spec_text: str
    spec_sha256: str
    seed: int
    timings: dict[str, Any]  # [s] by stage
    solvers: dict[str, Any]
    sizes: dict[str, Any]
    history: tuple[Improvement, ...] = ()
    loop: LoopRecord | None = None  # of `online`
    begun: Array | None = None  # (N + 1, 12) states that `micp` started from
    bound: float | None = None
    gap: float | None = None
    warnings: tuple[str, ...] = ()
    summary: tuple[str, ...] = ()
    robot_text: str = ""  # of the robot's file; empty for a built-in one
    verified: bool = False
    created: str = ""
    climbplan_version: str = ""
    not_finite: tuple[str, ...] = field(default=(), compare=False)  # found when reading
    at_odds: tuple[str, ...] = field(default=(), compare=False)  # what a file says twice, otherwise
