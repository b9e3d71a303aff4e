"""The summary of an MPC plan for the terminal."""

from __future__ import annotations

import numpy as np

from climbplan.arrays import BoolArray
from climbplan.walking.plan.walk_plan import WalkPlan
from climbplan.walking.task.task import ANGLES, POSITION, VELOCITY

_MIN_TURN = 1.0  # [deg] of a reference, to be reported
_MIN_BOUNCE = 0.06  # [m] to be reported; a normal walk stays below


def format_summary(plan: WalkPlan) -> tuple[str, ...]:
    """Return the lines that a run prints: scene, method, and tracking."""
    task, trajectory = plan.task, plan.trajectory
    horizon = 1e3 * task.dt * task.knots
    scene = f"{task.body.name} {task.body.mass:g} kg, {task.knots} intervals, {horizon:.0f} ms"
    effort = f"{plan.timings['method']:.2f} s   cost {plan.objective:.4g}"
    tried = f"{plan.sizes['gaits tried']} gaits   {format_gait(trajectory.gait.contact)}"
    lines = [
        f"{plan.name}   {scene}, {task.integrator} steps",
        f"{plan.method}   {plan.status}   {effort}, {tried}",
    ]
    if plan.bound is not None and plan.gap is not None:
        lines.append(
            f"bound   {plan.bound:.4g}, gap {100 * plan.gap:.0f} %: {plan.solvers['word']}"
        )
    lines.append(f"tracking   {_describe_tracking(plan)}")
    return tuple(lines)


def _describe_tracking(plan: WalkPlan) -> str:
    """Return the tracking errors in velocity, and in heading if it changes."""
    task, state = plan.task, plan.trajectory.state
    reference = task.reference
    velocity_error = np.linalg.norm((state[1:, VELOCITY] - reference.velocity)[:, :2], axis=1)
    first, last = velocity_error[0], velocity_error[-1]
    text = f"velocity off by {first:.2f} m/s at first, {last:.2f} m/s at the end"
    turn = np.rad2deg(np.append(state[[0, -1], ANGLES][:, 2], reference.euler[-1, 2]))
    if abs(turn[2] - turn[0]) > _MIN_TURN:
        text += f"; turned by {turn[1] - turn[0]:.0f} of {turn[2] - turn[0]:.0f} degrees"
    above = state[1:, POSITION][:, 2] - reference.height
    if np.ptp(above) > _MIN_BOUNCE:
        text += (
            f"; the body goes up and down by {1e3 * np.ptp(above):.0f} mm "
            "(weights.height and the third of weights.velocity hold it)"
        )
    return text


def format_gait(contact: BoolArray) -> str:
    """Return the number of standing legs of each interval: `4 4 2 2 0 4`."""
    return " ".join(str(int(count)) for count in contact[:-1].sum(axis=1))
