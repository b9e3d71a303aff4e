"""Simulated modules held against their plan: the box, joints, and what contacts bear."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from climbplan.arrays import Array
from climbplan.limms.simulation.replay import Bearing, ModuleRun


@dataclass(frozen=True)
class Borne:
    """The most that one contact bears while it is closed, planned and simulated."""

    name: str
    force: float  # [N]
    force_planned: float
    moment: float  # [N m]
    moment_planned: float


@dataclass(frozen=True)
class ModuleComparison:
    """Simulated beside planned (S samples)."""

    off: Array  # (S,) the worst box off its way [m]
    torque_off: Array  # (S, L, 6) |simulated - planned| [N m]
    borne: tuple[Borne, ...]  # by contact
    force_off: Array  # |simulated - planned| force of latches, all samples of all latches [N]


def compare_modules(run: ModuleRun) -> ModuleComparison:
    """Hold a run against its plan."""
    by_name: dict[str, list[Bearing]] = {}
    for bearing in run.bearings:
        by_name.setdefault(bearing.name, []).append(bearing)
    latches = [
        np.linalg.norm(bearing.found[:, :3] - bearing.planned[:, :3], axis=1)
        for bearing in run.bearings
        if bearing.kind == "latch"
    ]
    return ModuleComparison(
        off=np.linalg.norm(run.box - run.planned_box, axis=-1).max(axis=1),
        torque_off=np.abs(run.torque - run.planned_torque),
        borne=tuple(_borne(name, parts) for name, parts in by_name.items()),
        force_off=np.concatenate(latches) if latches else np.zeros(0),
    )


def _borne(name: str, parts: list[Bearing]) -> Borne:
    found = np.concatenate([part.found for part in parts])
    planned = np.concatenate([part.planned for part in parts])
    return Borne(
        name,
        float(np.linalg.norm(found[:, :3], axis=1).max()),
        float(np.linalg.norm(planned[:, :3], axis=1).max()),
        float(np.linalg.norm(found[:, 3:], axis=1).max()),
        float(np.linalg.norm(planned[:, 3:], axis=1).max()),
    )
