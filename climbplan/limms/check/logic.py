"""The logic rules of Table 6.2 on what a plan says about modes and latches.

As published, with what they leave open filled in:

- Latches have two ends. A module is "on" an anchor with either; an anchor holds at most one.
- 4: a leg is on one anchor of the box with one end; its other end is on nothing but ground.
- 6: an anchor that an arm is on belongs to a manipulated box (rule 5 the other way round).
- 7: exactly one anchor of the terrain for each arm.
- 9 to 11: added arms and legs are on exactly one end of another module; that other module is an arm
  or an added arm (a leg or an added leg) and holds no box; each end carries one module at most, and
  chains do not close on themselves.
- 12: a stable box stands on the ground, and may itself be stood on: a free module is latched to one
  of its sides with one end and to nothing else, on its way to an anchor (relatching; as published
  no mode describes a module that has let go of the ground and holds nothing but a box at rest).
- A free box touches nothing.
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


def broken(plan: LimmsPlan) -> dict[int, BoolArray]:
    """Samples (T,) that break each rule; 0 for anchors that hold two modules or do not exist."""
    motion = plan.motion
    boxes, anchors = len(plan.box_size), len(plan.anchor_names)
    ends = np.stack([motion.base_anchor, motion.tip_anchor], axis=-1)  # (T, L, 2)
    mode, box_mode = motion.mode, motion.box_mode
    on_box = (ends >= 0) & (ends < 4 * boxes)
    on_wall = (ends >= 4 * boxes) & (ends < anchors)
    on_module = ends >= anchors
    count = len(motion.time)
    holds = np.zeros((count, anchors), int)
    legs = np.zeros((count, 4 * boxes), int)
    arms = np.zeros((count, 4 * boxes), int)
    for module in range(mode.shape[1]):
        for end in (0, 1):
            here = ends[:, module, end]
            at = np.flatnonzero((here >= 0) & (here < anchors))
            holds[at, here[at]] += 1
            at = np.flatnonzero(on_box[:, module, end])
            is_leg = np.isin(mode[at, module], (4, 5))
            np.add.at(legs, (at[is_leg], here[at[is_leg]]), 1)
            is_arm = np.isin(mode[at, module], (2, 3))
            np.add.at(arms, (at[is_arm], here[at[is_arm]]), 1)
    by_legs, by_arms = legs.reshape(count, boxes, 4), arms.reshape(count, boxes, 4)
    held = holds[:, : 4 * boxes].reshape(count, boxes, 4)
    quadruped, manipulated = box_mode == 4, box_mode == 3
    box_of = np.where(on_box, ends // 4, 0)
    its_mode = np.take_along_axis(box_mode, box_of.reshape(count, -1), axis=1).reshape(ends.shape)
    is_leg, is_arm, added = mode == 4, mode == 2, np.isin(mode, (3, 5))
    carries, wrong_parent = _connections(ends, mode, anchors)
    return {
        0: (holds > 1).any(axis=1)
        | (ends >= anchors + 2 * mode.shape[1]).any(axis=(1, 2))
        | ~np.isin(mode, (1, 2, 3, 4, 5)).all(axis=1)
        | ~np.isin(box_mode, (1, 2, 3, 4)).all(axis=1),
        1: (quadruped[..., None] & (by_legs != 1)).any(axis=(1, 2)),
        2: ((by_legs > 0) & ~quadruped[..., None]).any(axis=(1, 2)),
        3: (on_box & (its_mode == 4) & ~np.isin(mode, (4, 5))[..., None]).any(axis=(1, 2)),
        4: (is_leg & ((on_box.sum(-1) != 1) | on_wall.any(-1))).any(axis=1),
        5: (manipulated & (by_arms.sum(-1) == 0)).any(axis=1),
        6: (on_box & (its_mode == 3) & ~np.isin(mode, (2, 3))[..., None]).any(axis=(1, 2)),
        7: (is_arm & (on_wall.sum(-1) != 1)).any(axis=1),
        8: (on_wall.any(-1) & ~is_arm).any(axis=1),
        9: (added & (on_module.sum(-1) != 1)).any(axis=1),
        10: (on_module.any(-1) & ~added).any(axis=1) | wrong_parent,
        11: (carries & on_box.any(-1)).any(axis=1),
        12: ((box_mode == 2)[..., None] & (held > 0)).any(axis=(1, 2))
        | (on_box & (its_mode == 1) & ~_stands_on_box(on_box, ends, mode)[..., None]).any(
            axis=(1, 2)
        ),
    }


def _stands_on_box(on_box: BoolArray, ends: np.ndarray, mode: np.ndarray) -> BoolArray:
    """Modules (T, L) that are free, one end on a box and the other on no anchor."""
    return np.asarray((mode == 1) & (on_box.sum(-1) == 1) & ((ends >= 0).sum(-1) == 1))


def _connections(ends: np.ndarray, mode: np.ndarray, anchors: int) -> tuple[BoolArray, BoolArray]:
    """Which modules carry another (T, L), and samples (T,) with a chain of the wrong kind."""
    count, modules = mode.shape
    rows = np.concatenate([ends.reshape(count, -1), mode], axis=1)
    kinds, which = np.unique(rows, axis=0, return_inverse=True)
    carries = np.zeros((len(kinds), modules), bool)
    wrong = np.zeros(len(kinds), bool)
    for k, row in enumerate(kinds):
        parents = _parents(row[: 2 * modules].reshape(modules, 2), anchors)
        for parent, _ in parents.values():
            carries[k, parent] = True
        wrong[k] = _is_wrong(row[: 2 * modules].reshape(modules, 2), row[2 * modules :], parents)
    which = which.reshape(-1)
    return carries[which], wrong[which]


def _parents(ends: np.ndarray, anchors: int) -> dict[tuple[int, int], tuple[int, int]]:
    """(module, end) on (other module, its end)."""
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
    """Whether an end carries two or holds on itself, families mix, or a chain hangs on nothing."""
    if len(set(parents.values())) < len(parents):
        return True
    above = {child: parent for (child, _), (parent, _) in parents.items()}
    for (child, _), (parent, its_end) in parents.items():
        family = 4 if mode[child] == 5 else 2
        if ends[parent, its_end] >= 0 or mode[parent] not in (family, family + 1):
            return True
        top = child
        for _ in range(len(ends)):
            top = above.get(top, top)
        if top in above or mode[top] not in (2, 4):
            return True
    return False
