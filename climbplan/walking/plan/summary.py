"""An MPC plan in a few lines."""

from __future__ import annotations

import numpy as np

from climbplan.arrays import BoolArray
from climbplan.walking.plan.walk_plan import WalkPlan
from climbplan.walking.task.task import ANGLES, POSITION, VELOCITY

_TURNS = 1.0  # [deg] that are asked for
_BOUNCE = 0.06  # [m] that is told: walks of a metre a second stay below it


def summary_lines(plan: WalkPlan) -> tuple[str, ...]:
    """What a run prints: the scene, the method, and how well the references are met."""
    task, found = plan.task, plan.trajectory
    ahead = 1e3 * task.step * task.knots
    where = f"{task.body.name} {task.body.mass:g} kg, {task.knots} intervals, {ahead:.0f} ms"
    spent = f"{plan.timings['method']:.2f} s   cost {plan.objective:.4g}"
    tried = f"{plan.sizes['gaits tried']} gaits   {gait_words(found.gait.contact)}"
    lines = [
        f"{plan.name}   {where}, {task.integrator} steps",
        f"{plan.method}   {plan.status}   {spent}, {tried}",
    ]
    if plan.bound is not None and plan.gap is not None:
        lines.append(
            f"bound   {plan.bound:.4g}, gap {100 * plan.gap:.0f} %: {plan.solvers['word']}"
        )
    lines.append(f"tracking   {_tracking(plan)}")
    return tuple(lines)


def _tracking(plan: WalkPlan) -> str:
    """How well the references are met: along the ground, in heading where it is to change."""
    task, state = plan.task, plan.trajectory.state
    reference = task.reference
    off = np.linalg.norm((state[1:, VELOCITY] - reference.velocity)[:, :2], axis=1)
    words = f"velocity off by {off[0]:.2f} m/s at first, {off[-1]:.2f} m/s at the end"
    turn = np.rad2deg(np.append(state[[0, -1], ANGLES][:, 2], reference.euler[-1, 2]))
    if abs(turn[2] - turn[0]) > _TURNS:
        words += f"; turned by {turn[1] - turn[0]:.0f} of {turn[2] - turn[0]:.0f} degrees"
    above = state[1:, POSITION][:, 2] - reference.height
    if np.ptp(above) > _BOUNCE:
        words += (
            f"; the body goes up and down by {1e3 * np.ptp(above):.0f} mm "
            "(weights.height and the third of weights.velocity hold it)"
        )
    return words


def gait_words(contact: BoolArray) -> str:
    """Standing legs of each interval as a number: `4 4 2 2 0 4`."""
    return " ".join(str(int(count)) for count in contact[:-1].sum(axis=1))
