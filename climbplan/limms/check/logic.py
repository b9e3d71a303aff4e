"""The logic rules of Table 6.2 on modes and latches of a plan.

As published, with open cases decided:

- Latches have two ends. A module is "on" an anchor with either; an anchor holds at most one.
- 4: a leg is on one anchor of the box with one end; its other end is on ground or nothing.
- 6: an anchor that an arm is on belongs to a manipulated box (the converse of rule 5).
- 7: exactly one anchor of the terrain for each arm.
- 9 to 11: added arms and legs are on exactly one end of another module. That module is an arm or an
  added arm (a leg or an added leg) and holds no box. Each end carries at most one module, and
  chains are not closed.
- 12: a stable box stands on the ground and may carry a free module. Such a module is latched to one
  of its sides with one end and to nothing else, on its way to an anchor (relatching). As published,
  no mode describes a module that has released the ground and holds only a box at rest.
- A free box has no contact.

Published methods, and table numbers, are those of X. Lin (UCLA 2022).
"""

from __future__ import annotations

import numpy as np

from climbplan.arrays import BoolArray
from climbplan.limms.plan.limms_plan import LimmsPlan

RULES = {
    1: "quadruped box: each of its anchors holds one leg",
    2: "an anchor that holds a leg: its box is a quadruped",
    3: "a module on an anchor of a quadruped: leg mode",
    4: "leg mode: on exactly one anchor of a box, its other end on no anchor",
    5: "manipulated box: at least one anchor holds an arm",
    6: "an anchor of a manipulated box: its module is an arm or an added arm",
    7: "arm: on exactly one anchor of walls or ground",
    8: "a held anchor of walls or ground: its module is an arm",
    9: "added arm: on exactly one other module",
    10: "a connection: parent arm or added arm, child added arm",
    11: "a module that carries another holds no box",
    12: "free box: all its anchors empty; stable box: on them only modules that stand on it alone",
}


def find_rule_violations(plan: LimmsPlan) -> dict[int, BoolArray]:
    """Return the samples (T,) that violate each rule; 0 for anchors with two modules or invalid."""
    motion = plan.motion
    boxes, anchors = len(plan.box_size), len(plan.anchor_names)
    ends = np.stack([motion.base_anchor, motion.tip_anchor], axis=-1)  # (T, L, 2)
    mode, box_mode = motion.mode, motion.box_mode
    on_box = (ends >= 0) & (ends < 4 * boxes)
    on_wall = (ends >= 4 * boxes) & (ends < anchors)
    on_module = ends >= anchors
    num_samples = len(motion.time)
    holds = np.zeros((num_samples, anchors), int)
    legs = np.zeros((num_samples, 4 * boxes), int)
    arms = np.zeros((num_samples, 4 * boxes), int)
    for module in range(mode.shape[1]):
        for end in (0, 1):
            anchors_of_end = ends[:, module, end]
            samples = np.flatnonzero((anchors_of_end >= 0) & (anchors_of_end < anchors))
            holds[samples, anchors_of_end[samples]] += 1
            samples = np.flatnonzero(on_box[:, module, end])
            is_leg = np.isin(mode[samples, module], (4, 5))
            np.add.at(legs, (samples[is_leg], anchors_of_end[samples[is_leg]]), 1)
            is_arm = np.isin(mode[samples, module], (2, 3))
            np.add.at(arms, (samples[is_arm], anchors_of_end[samples[is_arm]]), 1)
    by_legs, by_arms = legs.reshape(num_samples, boxes, 4), arms.reshape(num_samples, boxes, 4)
    holds_on_boxes = holds[:, : 4 * boxes].reshape(num_samples, boxes, 4)
    quadruped, manipulated = box_mode == 4, box_mode == 3
    box_of = np.where(on_box, ends // 4, 0)
    mode_of_box = np.take_along_axis(box_mode, box_of.reshape(num_samples, -1), axis=1).reshape(
        ends.shape
    )
    is_leg, is_arm, is_added = mode == 4, mode == 2, np.isin(mode, (3, 5))
    carries, wrong_parent = _find_connections(ends, mode, anchors)
    return {
        0: (holds > 1).any(axis=1)
        | (ends >= anchors + 2 * mode.shape[1]).any(axis=(1, 2))
        | ~np.isin(mode, (1, 2, 3, 4, 5)).all(axis=1)
        | ~np.isin(box_mode, (1, 2, 3, 4)).all(axis=1),
        1: (quadruped[..., None] & (by_legs != 1)).any(axis=(1, 2)),
        2: ((by_legs > 0) & ~quadruped[..., None]).any(axis=(1, 2)),
        3: (on_box & (mode_of_box == 4) & ~np.isin(mode, (4, 5))[..., None]).any(axis=(1, 2)),
        4: (is_leg & ((on_box.sum(-1) != 1) | on_wall.any(-1))).any(axis=1),
        5: (manipulated & (by_arms.sum(-1) == 0)).any(axis=1),
        6: (on_box & (mode_of_box == 3) & ~np.isin(mode, (2, 3))[..., None]).any(axis=(1, 2)),
        7: (is_arm & (on_wall.sum(-1) != 1)).any(axis=1),
        8: (on_wall.any(-1) & ~is_arm).any(axis=1),
        9: (is_added & (on_module.sum(-1) != 1)).any(axis=1),
        10: (on_module.any(-1) & ~is_added).any(axis=1) | wrong_parent,
        11: (carries & on_box.any(-1)).any(axis=1),
        12: ((box_mode == 2)[..., None] & (holds_on_boxes > 0)).any(axis=(1, 2))
        | (on_box & (mode_of_box == 1) & ~_is_standing_on_box(on_box, ends, mode)[..., None]).any(
            axis=(1, 2)
        ),
    }


def _is_standing_on_box(on_box: BoolArray, ends: np.ndarray, mode: np.ndarray) -> BoolArray:
    """Return which modules (T, L) are free, one end on a box and the other on no anchor."""
    return np.asarray((mode == 1) & (on_box.sum(-1) == 1) & ((ends >= 0).sum(-1) == 1))


def _find_connections(
    ends: np.ndarray, mode: np.ndarray, anchors: int
) -> tuple[BoolArray, BoolArray]:
    """Return which modules carry another (T, L), and samples (T,) with an invalid chain."""
    count, modules = mode.shape
    rows = np.concatenate([ends.reshape(count, -1), mode], axis=1)
    states, inverse = np.unique(rows, axis=0, return_inverse=True)
    carries = np.zeros((len(states), modules), bool)
    is_wrong = np.zeros(len(states), bool)
    for k, row in enumerate(states):
        parents = _find_parents(row[: 2 * modules].reshape(modules, 2), anchors)
        for parent, _ in parents.values():
            carries[k, parent] = True
        is_wrong[k] = _is_wrong(row[: 2 * modules].reshape(modules, 2), row[2 * modules :], parents)
    inverse = inverse.reshape(-1)
    return carries[inverse], is_wrong[inverse]


def _find_parents(ends: np.ndarray, anchors: int) -> dict[tuple[int, int], tuple[int, int]]:
    """Return the parent end of each connected end, as (module, end) pairs."""
    last = len(ends) - 1
    return {
        (m, end): (min((int(ends[m, end]) - anchors) // 2, last), (int(ends[m, end]) - anchors) % 2)
        for m in range(len(ends))
        for end in (0, 1)
        if ends[m, end] >= anchors
    }


def _is_wrong(
    ends: np.ndarray, mode: np.ndarray, parents: dict[tuple[int, int], tuple[int, int]]
) -> bool:
    """Return whether an end carries two or itself, families mix, or a chain has no root."""
    if len(set(parents.values())) < len(parents):
        return True
    parent_of = {child: parent for (child, _), (parent, _) in parents.items()}
    for (child, _), (parent, parent_end) in parents.items():
        family = 4 if mode[child] == 5 else 2
        if ends[parent, parent_end] >= 0 or mode[parent] not in (family, family + 1):
            return True
        root = child
        for _ in range(len(ends)):
            root = parent_of.get(root, root)
        if root in parent_of or mode[root] not in (2, 4):
            return True
    return False
