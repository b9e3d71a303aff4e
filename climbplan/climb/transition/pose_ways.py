"""The best ways of a contact sequence through the poses that were searched.

Poses of neighbouring rounds only depend on each other by the length of the step between them, so
that the cheapest way, and the largest safety factors that a sequence allows, are dynamic programs.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence as Many
from dataclasses import dataclass

import numpy as np

from climbplan.arrays import Array, BoolArray, IntArray
from climbplan.climb.transition.stances import LIFTED, Laboratory, largest_friction_factor

State = tuple[int, ...]  # a foothold number for every limb


@dataclass(frozen=True)
class Sequence:
    """One contact sequence with its best way through the poses searched."""

    states: tuple[State, ...]  # (M + 1)
    poses: tuple[int, ...]  # (M + 1) of least cost
    cost: float
    safety_torque: float  # the largest S_tau it allows, through poses of its own
    safety_friction: float = 0.0  # the largest S_mu it allows at the poses of either way
    firm_poses: tuple[int, ...] = ()  # (M + 1) of the largest S_tau

    @property
    def moved(self) -> BoolArray:
        """(M, N) limbs of each round."""
        return np.diff(np.array(self.states), axis=0) != 0


def cheapest_way(
    lab: Laboratory, states: tuple[State, ...], uses: Many[Array], step_cost: Array, first: Array
) -> Sequence | None:
    """The cheapest way of states and the one of the largest S_tau; None if steps are too long.

    uses: torque use (B,) of each round by pose. step_cost: (B, B) between poses, infinite where a
    step is too long. first: (B,) cost of shifting the body there before the first lift, likewise;
    the step of the first round counts from the start.
    """
    weights = lab.scene.spec.posture.weights
    last = lab.poses.count - 1
    cost, back = first, []
    firm, firm_back = np.where(np.isfinite(first), 0.0, np.inf), []
    for number, use in enumerate(uses):
        steps = np.broadcast_to(step_cost[0], step_cost.shape) if number == 0 else step_cost
        allowed = np.where(np.isfinite(steps), 0.0, np.inf)
        ways = (cost + weights.effort * use)[:, None] + steps
        back.append(ways.argmin(axis=0))
        cost = ways.min(axis=0)
        worst = np.maximum(np.maximum(firm, use)[:, None], allowed)
        firm_back.append(worst.argmin(axis=0))
        firm = worst.min(axis=0)
    if not np.isfinite(cost[last]):
        return None
    limb = np.arange(len(states[0]))
    toes = lab.footholds.toe[limb, np.array(states)]
    moved = weights.toe * np.sum(np.diff(toes, axis=0) ** 2)
    return Sequence(
        states=states,
        poses=_traced(back, last),
        cost=float(cost[last] + moved),
        safety_torque=float(1 / firm[last]) if firm[last] > 0 else np.inf,
        firm_poses=_traced(firm_back, last),
    )


def with_friction(lab: Laboratory, found: list[Sequence]) -> list[Sequence]:
    """The sequences with the largest S_mu they allow, at the poses of either way."""
    cells: dict[tuple[State, int], int] = {}
    for sequence in found:
        for cell in itertools.chain.from_iterable(_cells(sequence)):
            cells.setdefault(cell, len(cells))
    if not cells:
        return found
    stances = np.array([stance for stance, _ in cells], np.int64)
    poses = np.array([b for _, b in cells], np.int64)
    factor = largest_friction_factor(lab, stances, poses)
    out = []
    for sequence in found:
        ways = [min(factor[cells[cell]] for cell in way) for way in _cells(sequence)]
        out.append(Sequence(**(vars(sequence) | {"safety_friction": float(max(ways))})))
    return out


def _cells(sequence: Sequence) -> list[list[tuple[State, int]]]:
    """Stances and poses of every round, along the cheapest way and along the firmest."""
    stances = [stance_of_move(a, b) for a, b in itertools.pairwise(sequence.states)]
    return [
        list(zip(stances, way[:-1], strict=True)) for way in (sequence.poses, sequence.firm_poses)
    ]


def stance_of_move(state: State, after: State) -> State:
    """The limbs that hold the body while the others move."""
    return tuple(a if a == b else LIFTED for a, b in zip(state, after, strict=True))


def _traced(back: list[IntArray], last: int) -> tuple[int, ...]:
    """The poses that lead to the last one."""
    way = [last]
    for previous in reversed(back):
        way.append(int(previous[way[-1]]))
    return tuple(reversed(way))
