"""Comparison of simulated modules with their plan: box, joints and contact loads."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from climbplan.arrays import Array
from climbplan.limms.simulation.replay import Bearing, ModuleRun


@dataclass(frozen=True)
class ContactExtremes:
    """The largest loads of one contact while closed, planned and simulated."""

    name: str
    force: float  # [N]
    force_planned: float
    moment: float  # [N m]
    moment_planned: float


@dataclass(frozen=True)
class ModuleComparison:
    """Differences of simulation and plan (S samples)."""

    box_error: Array  # (S,) largest error of any box [m]
    torque_error: Array  # (S, L, 6) |simulated - planned| [N m]
    contacts: tuple[ContactExtremes, ...]  # by contact
    force_error: Array  # |simulated - planned| force of latches, all samples of all latches [N]


def compare_modules(run: ModuleRun) -> ModuleComparison:
    """Compare a run with its plan."""
    by_name: dict[str, list[Bearing]] = {}
    for bearing in run.bearings:
        by_name.setdefault(bearing.name, []).append(bearing)
    latches = [
        np.linalg.norm(bearing.found[:, :3] - bearing.planned[:, :3], axis=1)
        for bearing in run.bearings
        if bearing.kind == "latch"
    ]
    return ModuleComparison(
        box_error=np.linalg.norm(run.box - run.planned_box, axis=-1).max(axis=1),
        torque_error=np.abs(run.torque - run.planned_torque),
        contacts=tuple(
            _compare_bearings(name, latch_bearings) for name, latch_bearings in by_name.items()
        ),
        force_error=np.concatenate(latches) if latches else np.zeros(0),
    )


def _compare_bearings(name: str, bearings: list[Bearing]) -> ContactExtremes:
    """Return the largest loads of a contact over its closed times."""
    simulated = np.concatenate([bearing.found for bearing in bearings])
    planned = np.concatenate([bearing.planned for bearing in bearings])
    return ContactExtremes(
        name,
        float(np.linalg.norm(simulated[:, :3], axis=1).max()),
        float(np.linalg.norm(planned[:, :3], axis=1).max()),
        float(np.linalg.norm(simulated[:, 3:], axis=1).max()),
        float(np.linalg.norm(planned[:, 3:], axis=1).max()),
    )
