"""Figures of a dataset of motions: planned and usable rows by robot and scene."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from climbplan.arrays import BoolArray
from climbplan.datasets.motions.rows import KIND
from climbplan.datasets.motions.scenes import NO_ROBOT
from climbplan.store.dataset import Dataset

_OF_SPEC = "of its spec"  # robots of scenes from specs


@dataclass(frozen=True)
class MotionCount:
    """How the rows of one robot and scene ended."""

    robot: str
    scene: str
    rows: int
    planned: int  # and verified
    usable: int
    seconds: float  # of usable motions, in all [s]
    cpu_planning: float  # with verification, mean of planned rows [s]; 0 of none
    cpu_simulation: float  # likewise [s]


def count_motions(data: Dataset) -> list[MotionCount]:
    """Return the rows by robot and scene; none of datasets of other kinds."""
    if data.frame.kind != KIND:
        return []
    facts = data.frame.facts
    robots, scenes = list(facts.get("robots", [])), list(facts.get("scenes", []))
    names = list(data.frame.parameter_names)
    robot, scene = (
        np.where(data.drawn, data.parameters[:, names.index(name)], np.nan)
        for name in ("robot", "scene")
    )
    return [
        _count(data, who, what, (robot == i) & (scene == k))
        for k, what in enumerate(scenes)
        for i, who in [(NO_ROBOT, _OF_SPEC), *enumerate(robots)]
        if ((robot == i) & (scene == k)).any()
    ]


def _count(data: Dataset, robot: str, scene: str, chosen: BoolArray) -> MotionCount:
    planned = chosen & data.feasible
    usable = planned & data.solution["usable"].astype(bool)
    count = max(int(planned.sum()), 1)
    return MotionCount(
        robot=robot,
        scene=scene,
        rows=int(chosen.sum()),
        planned=int(planned.sum()),
        usable=int(usable.sum()),
        seconds=float(data.objective[usable].sum()),
        cpu_planning=float(data.solution["cpu_plan"][planned].sum()) / count,
        cpu_simulation=float(data.solution["cpu_simulation"][planned].sum()) / count,
    )


def build_motion_values(data: Dataset) -> list[dict[str, Any]]:
    """Return the same as plain values."""
    return [asdict(count) for count in count_motions(data)]


def format_motion_counts(data: Dataset) -> list[str]:
    """Return lines for people."""
    return [
        f"{'motions':<11} {count.robot}, {count.scene}: {count.planned} of {count.rows} planned, "
        f"{count.usable} usable ({count.seconds:.0f} s), "
        f"{count.cpu_planning + count.cpu_simulation:.1f} s of CPU each"
        for count in count_motions(data)
    ]
