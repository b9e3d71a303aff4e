"""Names and order of legs by position, and the order in which they step."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from climbplan.arrays import Array

_ROW_NAMES = {1: ("",), 2: ("F", "R"), 3: ("F", "M", "R")}  # front, middle, rear
_MIN_ARM_HEIGHT = 0.15  # [m] by which arms begin above legs
_MIDDLE_TOLERANCE = 1e-3  # [m]


@dataclass(frozen=True)
class LegNaming:
    """Names, leg order and gait order of N legs."""

    order: tuple[int, ...]  # indices of the given legs in leg order
    names: tuple[str, ...]  # in leg order
    gait: tuple[str, ...]  # names from rear to front, one side after the other
    is_by_place: bool  # whether names follow from positions
    is_arm: tuple[bool, ...]  # in leg order, limbs that begin clearly above others


def name_legs(hips: Array, links: list[str], groups: list[int]) -> LegNaming:
    """Name legs by the positions of their first joints.

    Args:
        hips: First joints (N, 3), x right, y forward, z up [m].
        links: Links of their toes, which name them where positions do not.
        groups: Number of the group of similar limbs that each leg belongs to.
    """
    left = [i for i in range(len(hips)) if hips[i, 0] < -_MIDDLE_TOLERANCE]
    right = [i for i in range(len(hips)) if hips[i, 0] > _MIDDLE_TOLERANCE]
    heights = {
        group: np.mean([hips[i, 2] for i in _list_group(groups, group)]) for group in set(groups)
    }
    kinds = dict.fromkeys(heights, "")
    if len(heights) == 2:  # arms and legs, or front and rear legs
        high, low = sorted(heights, key=lambda group: -heights[group])
        if heights[high] - heights[low] > _MIN_ARM_HEIGHT:
            kinds = {high: "arm", low: "leg"}
        else:
            groups, kinds = [0] * len(groups), {0: ""}
    names: dict[int, str] = {}
    for group, kind in kinds.items():
        for side, side_legs in (("R", right), ("L", left)):
            legs = sorted((i for i in side_legs if groups[i] == group), key=lambda i: -hips[i, 1])
            row_names = _ROW_NAMES.get(len(legs), tuple(str(n + 1) for n in range(len(legs))))
            for i, place in zip(legs, row_names, strict=True):
                names[i] = "_".join(
                    component for component in (f"{side}{place}", kind) if component
                )
    paired = len(left) == len(right) and len(names) == len(hips)
    if not paired or len(set(names.values())) < len(hips):
        order = tuple(range(len(hips)))
        return LegNaming(order, tuple(links), tuple(links), False, (False,) * len(hips))
    # Around the body: down the right side, up the left
    down = sorted(right, key=lambda i: -hips[i, 1])
    up = sorted(left, key=lambda i: hips[i, 1])
    gait_order = [*up, *down[::-1]]
    order = (*down, *up)
    arms = tuple(kinds[groups[i]] == "arm" for i in order)
    gait_order = [
        *(i for i in gait_order if kinds[groups[i]] != "arm"),
        *(i for i in gait_order if kinds[groups[i]] == "arm"),
    ]
    return LegNaming(
        order, tuple(names[i] for i in order), tuple(names[i] for i in gait_order), True, arms
    )


def _list_group(groups: list[int], group: int) -> list[int]:
    """Return the legs of a group."""
    return [i for i, number in enumerate(groups) if number == group]


def find_mirrored_legs(hips: Array) -> tuple[int | None, ...]:
    """Return for each first joint (N, 3) the leg on the other side, None where there is none."""
    twins: list[int | None] = []
    for i, hip in enumerate(hips):
        distance = np.linalg.norm(hips * [-1.0, 1.0, 1.0] - hip, axis=1)
        distance[i] = np.inf
        twin = int(np.argmin(distance))
        twins.append(twin if distance[twin] < 0.25 * abs(2 * hip[0]) + _MIDDLE_TOLERANCE else None)
    return tuple(twins)
