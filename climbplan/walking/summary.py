"""An MPC plan in a few lines."""

from __future__ import annotations

import numpy as np

from climbplan.walking.plan import WalkPlan
from climbplan.walking.task import VELOCITY, Flags


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
    off = np.linalg.norm(found.state[1:, VELOCITY] - task.reference.velocity, axis=1)
    lines.append(
        f"tracking   velocity off by {off[0]:.2f} m/s at first, {off[-1]:.2f} m/s at the end"
    )
    return tuple(lines)


def gait_words(contact: Flags) -> str:
    """Standing legs of each interval as a number: `4 4 2 2 0 4`."""
    return " ".join(str(int(count)) for count in contact[:-1].sum(axis=1))
