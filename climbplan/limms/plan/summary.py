"""The lines that a run prints, and the plan's story in words."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import groupby

import numpy as np

from climbplan.arrays import Array, IntArray
from climbplan.limms.plan.limms_plan import BOX_MODES, LimmsPlan

_FEW_NOTES = 3


def summary_lines(plan: LimmsPlan, notes: Sequence[str]) -> tuple[str, ...]:
    """Head, search, program and motion lines as shown on a terminal."""
    sizes, times = plan.sizes, plan.timings
    head = f"{plan.name:<16} {sizes['modules']} modules, {boxes_in_words(plan)}, "
    head += f"method {plan.method}"
    tried = f"{sizes['sequences_tried']} of {sizes['sequences']} sequences tried"
    found = f"{plan.sequence} ({sizes['configurations']} configurations, {tried})"
    search = f"{'modes':<9} {'found':<9} {times['search']:.2f} s   {found}"
    programs = (
        f"{'programs':<9} {sizes['programs']} solved  {times['build'] + times['solve']:.2f} s   "
        f"last one {sizes['variables']} variables, {sizes['constraints']} constraints"
    )
    return (head, search, *refused_lines(notes), programs, motion_line(plan))


def boxes_in_words(plan: LimmsPlan) -> str:
    """The boxes to deliver and what they weigh."""
    masses = [f"{mass:g} kg" for mass in plan.box_mass[: plan.deliveries]]
    return f"box {masses[0]}" if len(masses) == 1 else f"{len(masses)} boxes {', '.join(masses)}"


def motion_line(plan: LimmsPlan) -> str:
    """What each box does, how long all took, and how it ends."""
    count = plan.deliveries
    speed = float(np.linalg.norm(plan.motion.box_velocity[-1, count - 1]))
    moves = "; ".join(
        ("box " if count == 1 else f"box {b} ")
        + ", ".join(f"{BOX_MODES[mode]} {seconds:.2f} s" for mode, seconds in box_story(plan, b))
        + _turned(plan, b)
        for b in range(count)
    )
    off = f"{1e3 * plan.objective:.2f} mm off its goal at {speed:.2f} m/s"
    ends = f"ends {off}" if count == 1 else f"the worst ends {off}"
    return f"{'motion':<9} {plan.status:<9} {plan.timings['total']:.2f} s   {moves}; {ends}"


def _turned(plan: LimmsPlan, box: int) -> str:
    """By how much a box is turned in the end, if it is."""
    yaw = plan.motion.box_yaw[:, box]
    return f", turned by {np.degrees(yaw[-1] - yaw[0]):.1f} degrees" if np.ptp(yaw) > 0 else ""


def refused_lines(notes: Sequence[str]) -> list[str]:
    """What was tried in vain, the first of it."""
    refused = [f"{'refused':<9} {note}" for note in dict.fromkeys(notes)]
    if len(refused) > _FEW_NOTES:
        refused = [*refused[:_FEW_NOTES], f"{'refused':<9} and {len(refused) - _FEW_NOTES} more"]
    return refused


def box_story(plan: LimmsPlan, box: int = 0) -> list[tuple[int, float]]:
    """Modes of a box, in order, with the time it spends in each [s]."""
    return _story(plan.motion.time, plan.motion.box_mode[:, box])


def module_story(plan: LimmsPlan, module: int) -> list[tuple[int, float]]:
    """Modes of a module, in order, with the time it spends in each [s]."""
    return _story(plan.motion.time, plan.motion.mode[:, module])


def _story(time: Array, modes: IntArray) -> list[tuple[int, float]]:
    story = []
    pairs = zip(modes[:-1], np.diff(time), strict=True)
    for mode, group in groupby(pairs, key=lambda pair: int(pair[0])):
        story.append((mode, float(sum(step for _, step in group))))
    return [(mode, seconds) for mode, seconds in story if seconds > 0]
