"""What holds what between two events: latches, ends on the ground, the box on the ground."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from climbplan.arrays import Array
from climbplan.limms.check.dense import Stretch
from climbplan.limms.plan.limms_plan import LimmsPlan
from climbplan.limms.schema.module import ModuleSpec

_STABLE = 1
NOBODY = -1


@dataclass(frozen=True, eq=False)
class Contact:
    """A place where a body is held by another one, or by the terrain (`other` = -1).

    Bodies: modules by their number, then the boxes to deliver.
    """

    kind: str  # "latch", "ground" (an end that stands), "box" (the box that stands)
    body: int
    end: int  # of the module: 0 first, 1 last
    other: int
    other_end: int  # where the other one is a module
    place: Array  # (M, 3) [m]
    name: str  # in the robot's terms

    def scale(self, module: ModuleSpec) -> Array:
        """(6,) what a force [N] and a moment [N m] are compared to when loads are shared."""
        moment = module.latch_moment
        if self.kind == "ground":
            moment = module.radius * module.max_force + module.ground_moment
        return np.repeat([module.max_force, moment], 3)


def contacts_of(plan: LimmsPlan, stretch: Stretch) -> list[Contact]:
    """All contacts of a stretch."""
    motion, first = plan.motion, stretch.first
    count, anchors = len(plan.module_names), len(plan.anchor_names)
    found = []
    for m, name in enumerate(plan.module_names):
        for end, held in enumerate((motion.base_anchor[first, m], motion.tip_anchor[first, m])):
            place = stretch.points[m].position[:, 7 * end]
            other, other_end = NOBODY, 0
            if held >= anchors:
                other, other_end = divmod(int(held) - anchors, 2)
                what = f"latch of {name} on {plan.module_names[other]}"
            elif held >= 0:
                other = count + held // 4 if held < 4 * plan.deliveries else NOBODY
                what = f"latch of {name} on {plan.anchor_names[held]}"
            elif motion.ground_end[first, m] == end:
                found.append(Contact("ground", m, end, other, 0, place, f"ground under {name}"))
                continue
            else:
                continue
            found.append(Contact("latch", m, end, other, other_end, place, what))
    for b in range(plan.deliveries):
        if motion.box_mode[first, b] == _STABLE:
            below = stretch.box[:, b] - np.array([0.0, 0.0, plan.box_size[b, 2] / 2])
            name = "ground under the box" if plan.deliveries == 1 else f"ground under box {b}"
            found.append(Contact("box", count + b, 0, NOBODY, 0, below, name))
    return found


def islands(bodies: int, contacts: list[Contact]) -> list[tuple[list[int], list[Contact]]]:
    """Bodies that hold on to one another, with their contacts."""
    label = list(range(bodies))
    for contact in contacts:
        if contact.other >= 0:
            old, new = label[contact.body], label[contact.other]
            label = [new if each == old else each for each in label]
    return [
        (
            [b for b in range(bodies) if label[b] == group],
            [c for c in contacts if label[c.body] == group],
        )
        for group in sorted(set(label))
    ]
