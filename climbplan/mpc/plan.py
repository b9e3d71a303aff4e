"""The result of an MPC run: task, trajectory and what the method says of it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from climbplan.mpc.answer import Improvement
from climbplan.mpc.task import WalkTask, WalkTrajectory

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
    bound: float | None = None
    gap: float | None = None
    warnings: tuple[str, ...] = ()
    summary: tuple[str, ...] = ()
    verified: bool = False
    created: str = ""
    climbplan_version: str = ""
    not_finite: tuple[str, ...] = field(default=(), compare=False)  # found when reading
