"""Find the best paths of a contact sequence through the poses that were searched.

Consecutive poses are coupled only by the step between them. The cheapest path, and the largest
safety factor that a sequence allows, therefore follow by dynamic programming.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from climbplan.arrays import Array, BoolArray, IntArray
from climbplan.climb.transition.stance_forces import LIFTED, SearchTables, find_max_friction_factor

State = tuple[int, ...]  # a foothold number for every limb


@dataclass(frozen=True)
class ContactSequence:
    """A contact sequence with its best paths through the poses searched."""

    states: tuple[State, ...]  # (M + 1)
    poses: tuple[int, ...]  # (M + 1) of least cost
    cost: float
    safety_torque: float  # the largest S_tau it allows, through poses of its own
    safety_friction: float = 0.0  # the largest S_mu it allows at the poses of either way
    firm_poses: tuple[int, ...] = ()  # (M + 1) of the largest S_tau

    @property
    def moves(self) -> BoolArray:
        """(M, N) limbs of each round."""
        return np.diff(np.array(self.states), axis=0) != 0


def find_cheapest_path(
    tables: SearchTables,
    states: tuple[State, ...],
    uses: Sequence[Array],
    step_cost: Array,
    first_cost: Array,
) -> ContactSequence | None:
    """Find the cheapest path of states and that of largest S_tau; None if steps are too long.

    uses: torque use (B,) of each round by pose. step_cost: (B, B) between poses, infinite where a
    step is too long. first_cost: (B,) cost of shifting the body before the first lift, likewise;
    the step of the first round counts from the start.
    """
    weights = tables.scene.spec.posture.weights
    last = tables.poses.count - 1
    cost, cheapest_predecessors = first_cost, []
    max_use, firmest_predecessors = np.where(np.isfinite(first_cost), 0.0, np.inf), []
    for number, torque_use in enumerate(uses):
        steps = np.broadcast_to(step_cost[0], step_cost.shape) if number == 0 else step_cost
        allowed = np.where(np.isfinite(steps), 0.0, np.inf)
        costs = (cost + weights.effort * torque_use)[:, None] + steps
        cheapest_predecessors.append(costs.argmin(axis=0))
        cost = costs.min(axis=0)
        path_use = np.maximum(np.maximum(max_use, torque_use)[:, None], allowed)
        firmest_predecessors.append(path_use.argmin(axis=0))
        max_use = path_use.min(axis=0)
    if not np.isfinite(cost[last]):
        return None
    limb = np.arange(len(states[0]))
    toes = tables.footholds.toe[limb, np.array(states)]
    toe_cost = weights.toe * np.sum(np.diff(toes, axis=0) ** 2)
    return ContactSequence(
        states=states,
        poses=_trace_path(cheapest_predecessors, last),
        cost=float(cost[last] + toe_cost),
        safety_torque=float(1 / max_use[last]) if max_use[last] > 0 else np.inf,
        firm_poses=_trace_path(firmest_predecessors, last),
    )


def add_friction_factors(
    tables: SearchTables, sequences: list[ContactSequence]
) -> list[ContactSequence]:
    """Add the largest S_mu that sequences allow on either of their paths."""
    cells: dict[tuple[State, int], int] = {}
    for sequence in sequences:
        for cell in itertools.chain.from_iterable(_list_stance_poses(sequence)):
            cells.setdefault(cell, len(cells))
    if not cells:
        return sequences
    stances = np.array([stance for stance, _ in cells], np.int64)
    poses = np.array([b for _, b in cells], np.int64)
    factor = find_max_friction_factor(tables, stances, poses)
    result = []
    for sequence in sequences:
        path_factors = [
            min(factor[cells[cell]] for cell in path) for path in _list_stance_poses(sequence)
        ]
        result.append(
            ContactSequence(**(vars(sequence) | {"safety_friction": float(max(path_factors))}))
        )
    return result


def _list_stance_poses(sequence: ContactSequence) -> list[list[tuple[State, int]]]:
    """List stances and poses of every round, on the cheapest path and on that of largest S_tau."""
    stances = [get_stance(a, b) for a, b in itertools.pairwise(sequence.states)]
    return [
        list(zip(stances, path[:-1], strict=True)) for path in (sequence.poses, sequence.firm_poses)
    ]


def get_stance(state: State, after: State) -> State:
    """Return the stance of a move: footholds of the limbs that stay, others LIFTED."""
    return tuple(a if a == b else LIFTED for a, b in zip(state, after, strict=True))


def _trace_path(predecessors: list[IntArray], last: int) -> tuple[int, ...]:
    """Trace the poses that lead to the last one by their predecessors."""
    path = [last]
    for previous in reversed(predecessors):
        path.append(int(previous[path[-1]]))
    return tuple(reversed(path))
