"""Names and order of legs by where they are, and the order in which they step."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from climbplan.arrays import Array

_ROWS = {1: ("",), 2: ("F", "R"), 3: ("F", "M", "R")}  # front, middle, rear
_HIGHER = 0.15  # [m] by which arms begin above legs
_ON_MIDDLE = 1e-3  # [m]


@dataclass(frozen=True)
class Named:
    """Legs in their order."""

    order: tuple[int, ...]  # of the legs given
    names: tuple[str, ...]  # in that order
    gait: tuple[str, ...]  # from rear to front, one side after the other
    by_place: bool  # whether they are named by where they are
    arms: tuple[bool, ...]  # of those in that order that begin clearly above others


def named(hips: Array, links: list[str], groups: list[int]) -> Named:
    """Names of legs with first joints at hips (N, 3): x right, y forward, z up.

    links: of their toes, which name them where places do not; groups: number of the group of limbs
    alike that each leg is of.
    """
    left = [i for i in range(len(hips)) if hips[i, 0] < -_ON_MIDDLE]
    right = [i for i in range(len(hips)) if hips[i, 0] > _ON_MIDDLE]
    ends = {group: np.mean([hips[i, 2] for i in _of(groups, group)]) for group in set(groups)}
    kinds = dict.fromkeys(ends, "")
    if len(ends) == 2:  # arms beside legs, or before them
        high, low = sorted(ends, key=lambda group: -ends[group])
        if ends[high] - ends[low] > _HIGHER:
            kinds = {high: "arm", low: "leg"}
        else:
            groups, kinds = [0] * len(groups), {0: ""}
    names: dict[int, str] = {}
    for group, kind in kinds.items():
        for side, own in (("R", right), ("L", left)):
            row = sorted((i for i in own if groups[i] == group), key=lambda i: -hips[i, 1])
            rows = _ROWS.get(len(row), tuple(str(n + 1) for n in range(len(row))))
            for i, place in zip(row, rows, strict=True):
                names[i] = "_".join(part for part in (f"{side}{place}", kind) if part)
    paired = len(left) == len(right) and len(names) == len(hips)
    if not paired or len(set(names.values())) < len(hips):
        order = tuple(range(len(hips)))
        return Named(order, tuple(links), tuple(links), False, (False,) * len(hips))
    # Round the body: down the right side, up the left
    down = sorted(right, key=lambda i: -hips[i, 1])
    up = sorted(left, key=lambda i: hips[i, 1])
    step = [*up, *down[::-1]]
    order = (*down, *up)
    arms = tuple(kinds[groups[i]] == "arm" for i in order)
    step = [
        *(i for i in step if kinds[groups[i]] != "arm"),
        *(i for i in step if kinds[groups[i]] == "arm"),
    ]
    return Named(order, tuple(names[i] for i in order), tuple(names[i] for i in step), True, arms)


def _of(groups: list[int], group: int) -> list[int]:
    return [i for i, own in enumerate(groups) if own == group]


def mirrored(hips: Array) -> tuple[int | None, ...]:
    """The leg on the other side of every leg, None where there is none."""
    out: list[int | None] = []
    for i, hip in enumerate(hips):
        away = np.linalg.norm(hips * [-1.0, 1.0, 1.0] - hip, axis=1)
        away[i] = np.inf
        other = int(np.argmin(away))
        out.append(other if away[other] < 0.25 * abs(2 * hip[0]) + _ON_MIDDLE else None)
    return tuple(out)
