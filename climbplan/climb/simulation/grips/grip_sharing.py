"""How palm and fingers share what a grip bears, and how near to slipping they are."""

from __future__ import annotations

import numpy as np

from climbplan.arrays import Array
from climbplan.climb.forces.cones import ConicProgram
from climbplan.mechanics.friction import contact_frame
from climbplan.mechanics.grip import GripCones


def beyond(cones: GripCones, parts: Array) -> float:
    """By how much parts (3, 3) leave their cones [N]."""
    return float(max(cones.excess(parts, 1.0).max(), (-cones.pressure(parts)).max()))


def used(slipping: tuple[float, float]) -> float:
    """Friction coefficient at which a part of such pressure and shear slips."""
    return slipping[1] / max(slipping[0], 1e-9)


def shared_at_best(cones: GripCones, parts: Array) -> tuple[float, Array]:
    """Least e >= 0 such that parts are within cones wider by e [N], and the palm's force (3,) then.

    parts: (3, 3) forces on palm and fingers of a palm that takes nothing.
    """
    program = ConicProgram(4)  # the palm's force and e
    for part in range(3):
        share = np.eye(3) if part == 0 else -np.eye(3) / 2
        axes = contact_frame(cones.normal[part]).axes
        rows, ends = np.zeros((3, 4)), axes @ parts[part]
        rows[:, :3] = -axes @ share
        mu = float(cones.mu)
        cone, end = rows.copy(), ends.copy()
        cone[0], end[0] = mu * rows[0], mu * ends[0] + cones.spines[part]
        cone[0, 3] = -1.0
        program.cone(f"cone.{part}", cone, end)
        press = rows[:1].copy()
        press[0, 3] = -1.0
        program.below(f"press.{part}", press, ends[:1])
    program.below("least", np.array([[0.0, 0.0, 0.0, -1.0]]), np.zeros(1))
    answer = program.minimise(np.array([0.0, 0.0, 0.0, 1.0]))
    if answer is None:
        return np.inf, np.zeros(3)
    return max(answer.value, 0.0), answer.x[:3]
