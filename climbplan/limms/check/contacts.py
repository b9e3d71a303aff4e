"""Contacts between two events: latches, ends on the ground, boxes on the ground."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from climbplan.arrays import Array
from climbplan.limms.check.dense import DenseStretch
from climbplan.limms.plan.limms_plan import LimmsPlan
from climbplan.limms.schema.module import ModuleSpec

_STABLE = 1
NOBODY = -1


@dataclass(frozen=True, eq=False)
class Contact:
    """A contact of a body with another one, or with the terrain (`other` = -1).

    Bodies are modules by their number, then the boxes to deliver.
    """

    kind: str  # "latch", "ground" (an end that stands), "box" (the box that stands)
    body: int
    end: int  # of the module: 0 first, 1 last
    other: int
    other_end: int  # where the other one is a module
    place: Array  # (M, 3) [m]
    name: str  # in the robot's terms

    def scale(self, module: ModuleSpec) -> Array:
        """Return the capacities (6,) for force [N] and moment [N m], which weight load sharing."""
        moment = module.latch_moment
        if self.kind == "ground":
            moment = module.radius * module.max_force + module.ground_moment
        return np.repeat([module.max_force, moment], 3)


def find_contacts(plan: LimmsPlan, stretch: DenseStretch) -> list[Contact]:
    """Return all contacts of a stretch."""
    motion, first = plan.motion, stretch.first
    count, anchors = len(plan.module_names), len(plan.anchor_names)
    contacts = []
    for m, name in enumerate(plan.module_names):
        for end, anchor in enumerate((motion.base_anchor[first, m], motion.tip_anchor[first, m])):
            position = stretch.points[m].position[:, 7 * end]
            carrier, carrier_end = NOBODY, 0
            if anchor >= anchors:
                carrier, carrier_end = divmod(int(anchor) - anchors, 2)
                label = f"latch of {name} on {plan.module_names[carrier]}"
            elif anchor >= 0:
                carrier = count + anchor // 4 if anchor < 4 * plan.deliveries else NOBODY
                label = f"latch of {name} on {plan.anchor_names[anchor]}"
            elif motion.ground_end[first, m] == end:
                contacts.append(
                    Contact("ground", m, end, carrier, 0, position, f"ground under {name}")
                )
                continue
            else:
                continue
            contacts.append(Contact("latch", m, end, carrier, carrier_end, position, label))
    for b in range(plan.deliveries):
        if motion.box_mode[first, b] == _STABLE:
            below = stretch.box[:, b] - np.array([0.0, 0.0, plan.box_size[b, 2] / 2])
            name = "ground under the box" if plan.deliveries == 1 else f"ground under box {b}"
            contacts.append(Contact("box", count + b, 0, NOBODY, 0, below, name))
    return contacts


def group_bodies(bodies: int, contacts: list[Contact]) -> list[tuple[list[int], list[Contact]]]:
    """Return groups of bodies connected by contacts, each with its contacts."""
    label = list(range(bodies))
    for contact in contacts:
        if contact.other >= 0:
            old_group, new_group = label[contact.body], label[contact.other]
            label = [
                new_group if group_of_body == old_group else group_of_body
                for group_of_body in label
            ]
    return [
        (
            [b for b in range(bodies) if label[b] == group],
            [c for c in contacts if label[c.body] == group],
        )
        for group in sorted(set(label))
    ]
