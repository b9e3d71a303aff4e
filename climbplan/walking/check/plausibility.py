"""What no walking robot has, told before all else (`verification/plausibility.py` says why)."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from climbplan.verification.plausibility import (
    implausible_force,
    implausible_friction,
    implausible_gravity,
)
from climbplan.walking.plan.walk_plan import WalkPlan

SPIN = 20.0  # [rad/s] three turns a second of the body


def implausible_walk(plan: WalkPlan) -> tuple[str, ...]:
    """Warnings about robot, ground and forces of a walk."""
    return tuple(_warnings(plan))


def _warnings(plan: WalkPlan) -> Iterator[str]:
    task, found = plan.task, plan.trajectory
    yield from implausible_gravity(task.body.gravity)
    yield from implausible_friction("the ground", task.ground.friction)
    size = np.linalg.norm(found.force, axis=-1)
    n, leg = (int(i) for i in np.unravel_index(int(np.argmax(size)), size.shape))
    where = f" ({task.body.leg_names[leg]}, {task.step * n:.2f} s)"
    weight = task.body.mass * task.body.gravity
    yield from implausible_force(float(size[n, leg]), weight, where)
    spin = float(np.abs(found.state[:, 9:]).max())
    if spin > SPIN:
        yield f"the body turns at {spin:.0f} rad/s"
