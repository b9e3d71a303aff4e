"""The result of an MPC run: task, trajectory and results of the method."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

from climbplan.arrays import Array, IntArray
from climbplan.store.root_attributes import PlanHeader
from climbplan.walking.plan.answer import Improvement
from climbplan.walking.task.task import WalkTask, WalkTrajectory

Forward = Literal["x", "y"]


@dataclass(frozen=True)
class LoopRecord:
    """The record of a closed loop by sample; figures of a tick are repeated at all its samples."""

    push: Array  # (T, 3) [m/s] change of velocity at each sample, which its state contains
    tick_time: Array  # (T,) [s]
    solve_time: Array  # (T,) [s]
    candidates_tried: IntArray  # (T,)
    # (T,) source of the plan: section of the library, -1 previous plan, -2 named gait,
    # -3 safe stance, -4 none (the plan continues)
    winner: IntArray
    warnings: tuple[str, ...]  # of ticks, each with its time
    samples: int  # from one knot to the next


STATUSES = ("feasible", "limit")


@dataclass(frozen=True, kw_only=True)
class WalkPlan(PlanHeader):
    """A run as it is stored in its plan file."""

    title: str
    method: str
    status: str
    task: WalkTask
    trajectory: WalkTrajectory
    objective: float
    terms: Mapping[str, float]  # of the objective
    history: tuple[Improvement, ...] = ()
    loop: LoopRecord | None = None  # of `online`
    initial_states: Array | None = (
        None  # (N + 1, 12) initial solution of `spatial-branch-and-bound`
    )
    bound: float | None = None
    gap: float | None = None
    robot_text: str = ""  # of the robot's file; empty for a built-in one
    robot_urdf: str = ""  # of the URDF that it names
    forward: Forward = "x"  # axis of the world that points forward; y: axes of climbs
