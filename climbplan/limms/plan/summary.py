"""The lines that a run prints, and modes with their durations."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import groupby

import numpy as np

from climbplan.arrays import Array, IntArray
from climbplan.limms.plan.limms_plan import BOX_MODES, LimmsPlan

_FEW_NOTES = 3


def format_plan_summary(plan: LimmsPlan, notes: Sequence[str]) -> tuple[str, ...]:
    """Return the lines of the summary: problem, search, programs and motion."""
    sizes, times = plan.sizes, plan.timings
    head = f"{plan.name:<16} {sizes['modules']} modules, {describe_boxes(plan)}, "
    head += f"method {plan.method}"
    tried = f"{sizes['sequences_tried']} of {sizes['sequences']} sequences tried"
    choice = f"{plan.sequence} ({sizes['configurations']} configurations, {tried})"
    search = f"{'modes':<9} {'found':<9} {times['search']:.2f} s   {choice}"
    programs = (
        f"{'programs':<9} {sizes['programs']} solved  {times['build'] + times['solve']:.2f} s   "
        f"last one {sizes['variables']} variables, {sizes['constraints']} constraints"
    )
    return (head, search, *format_failures(notes), programs, format_motion(plan))


def describe_boxes(plan: LimmsPlan) -> str:
    """Return the boxes to deliver and their masses in words."""
    masses = [f"{mass:g} kg" for mass in plan.box_mass[: plan.deliveries]]
    return f"box {masses[0]}" if len(masses) == 1 else f"{len(masses)} boxes {', '.join(masses)}"


def format_motion(plan: LimmsPlan) -> str:
    """Return what each box does, the planning time, and the final error."""
    count = plan.deliveries
    speed = float(np.linalg.norm(plan.motion.box_velocity[-1, count - 1]))
    moves = "; ".join(
        ("box " if count == 1 else f"box {b} ")
        + ", ".join(
            f"{BOX_MODES[mode]} {seconds:.2f} s" for mode, seconds in list_box_modes(plan, b)
        )
        + _describe_rotation(plan, b)
        for b in range(count)
    )
    error_text = f"{1e3 * plan.objective:.2f} mm off its goal at {speed:.2f} m/s"
    ends = f"ends {error_text}" if count == 1 else f"the worst ends {error_text}"
    return f"{'motion':<9} {plan.status:<9} {plan.timings['total']:.2f} s   {moves}; {ends}"


def _describe_rotation(plan: LimmsPlan, box: int) -> str:
    """Return the rotation of a box in words, empty without one."""
    yaw = plan.motion.box_yaw[:, box]
    return f", turned by {np.degrees(yaw[-1] - yaw[0]):.1f} degrees" if np.ptp(yaw) > 0 else ""


def format_failures(notes: Sequence[str]) -> list[str]:
    """Return the first failed attempts."""
    lines = [f"{'refused':<9} {note}" for note in dict.fromkeys(notes)]
    if len(lines) > _FEW_NOTES:
        lines = [*lines[:_FEW_NOTES], f"{'refused':<9} and {len(lines) - _FEW_NOTES} more"]
    return lines


def list_box_modes(plan: LimmsPlan, box: int = 0) -> list[tuple[int, float]]:
    """Return modes of a box, in order, with their durations [s]."""
    return _list_modes(plan.motion.time, plan.motion.box_mode[:, box])


def list_module_modes(plan: LimmsPlan, module: int) -> list[tuple[int, float]]:
    """Return modes of a module, in order, with their durations [s]."""
    return _list_modes(plan.motion.time, plan.motion.mode[:, module])


def _list_modes(time: Array, modes: IntArray) -> list[tuple[int, float]]:
    """Return modes in order, with their durations [s]."""
    runs = []
    pairs = zip(modes[:-1], np.diff(time), strict=True)
    for mode, group in groupby(pairs, key=lambda pair: int(pair[0])):
        runs.append((mode, float(sum(step for _, step in group))))
    return [(mode, seconds) for mode, seconds in runs if seconds > 0]
