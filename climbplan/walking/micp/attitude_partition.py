"""Spatial partition of the attitudes: the union of several boxes covers what one wide box would.

Rotations are linearised about the middle of an attitude box, so that the relaxation of a wide box
is weak. Two narrower boxes about parts of the motions replace it where their bounds are better.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from climbplan.arrays import Array
from climbplan.walking.micp.attitude_box import AttitudeBox, build_attitude_box
from climbplan.walking.task.task import ANGLES, SPIN, WalkTask

_MIN_SPLIT_GAIN = 0.02  # of the cutoff, by which a split has to raise the bound


@dataclass(frozen=True, eq=False)
class AttitudeCell:
    """An attitude box, the motions that it is about, and a lower bound on the cost within it."""

    attitude_box: AttitudeBox
    motions: Array  # (M, N + 1, 12)
    bound: float


def partition_attitudes(
    task: WalkTask,
    motions: Array,
    width: tuple[Array, Array],
    cutoff: float,
    compute_bound: Callable[[AttitudeBox], float],
    should_continue: Callable[[], bool],
) -> list[AttitudeCell]:
    """Partition motions into attitude boxes, splitting the one with the lowest bound.

    A split is kept if it raises the bound by enough. Splitting ends where all bounds reach the
    cutoff.

    Args:
        task: The task.
        motions: The motions (M, N + 1, 12) that the boxes contain.
        width: Half widths about a motion of angles (3,) [rad] and angular velocities (3,) [rad/s].
        cutoff: Cost that motions of interest are below.
        compute_bound: Lower bound on the cost of motions within a box.
        should_continue: Whether time is left for another split.

    Returns:
        The cells, whose union contains all motions.
    """

    def create_cell(members: Array) -> AttitudeCell:
        attitude_box = build_attitude_box(task, members, *width)
        return AttitudeCell(attitude_box, members, compute_bound(attitude_box))

    candidates, unsplit = [create_cell(motions)], list[AttitudeCell]()
    while candidates and should_continue():
        lowest = min(candidates, key=lambda cell: cell.bound)
        if lowest.bound >= cutoff:
            break
        candidates.remove(lowest)
        halves = split_motions(lowest.motions, *width)
        children = [create_cell(half) for half in halves] if halves is not None else []
        min_bound = lowest.bound + _MIN_SPLIT_GAIN * cutoff
        if children and min(cell.bound for cell in children) >= min_bound:
            candidates += children
        else:
            unsplit.append(lowest)
    return unsplit + candidates


def sort_narrow_first(cells: Sequence[AttitudeCell]) -> list[int]:
    """Return indices of cells: those about few motions first, then those with low bounds."""
    return sorted(range(len(cells)), key=lambda k: (len(cells[k].motions), cells[k].bound))


def split_motions(state: Array, angles: Array, omega: Array) -> tuple[Array, Array] | None:
    """Split motions in two clusters, about the two motions that are farthest apart.

    Args:
        state: Motions (M, N + 1, 12).
        angles: Unit of distance between angles (3,) [rad].
        omega: Unit of distance between angular velocities (3,) [rad/s].

    Returns:
        Both clusters; None if all motions are within one unit of each other.
    """
    unit = np.concatenate([angles, omega])
    rotation = np.concatenate([state[:, :-1, ANGLES], state[:, :-1, SPIN]], axis=-1) / unit
    distance = np.abs(rotation[:, None] - rotation[None]).max(axis=(2, 3))
    first, second = np.unravel_index(int(distance.argmax()), distance.shape)
    if distance[first, second] <= 1.0:
        return None
    is_in_first = distance[first] <= distance[second]
    return state[is_in_first], state[~is_in_first]
