"""The gait that a plan's instants follow, counted from which limbs are in the air when.

Instants come in pairs, two for each step: limbs lifted, then placed and the body pushed on. In a
climb every round moves each limb once, one a step and always in the same order; in a transition a
round may be of any steps, each of one limb or more.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from climbplan.arrays import Array, BoolArray, IntArray
from climbplan.climb.plan.climb_plan import ClimbPlan, Rounds


@dataclass(frozen=True)
class Gait:
    """K instants in S = K / 2 steps."""

    moved: BoolArray  # (S, N) the limbs of each step
    round: IntArray  # (S,) the round of each step, 1..M
    stood: IntArray  # (K, N) the round whose foothold each limb is on, or left; 0 for the start
    station_com: Array  # (S + 1, 3) where the body waits before each step and after the last
    station_rpy: Array  # (S + 1, 3)
    shift: Array  # (S, 3) of these off the straight way, zero where plans may not leave it
    broken: BoolArray  # (K,) limbs lifted where none or some should be, out of turn or round

    @property
    def steps(self) -> int:
        """S."""
        return len(self.moved)

    @property
    def com(self) -> Array:
        """(K, 3) where the body is to be at the instants."""
        return self.station_com[self._station]

    @property
    def rpy(self) -> Array:
        """(K, 3) likewise."""
        return self.station_rpy[self._station]

    @property
    def _station(self) -> IntArray:
        instant = np.arange(2 * self.steps)
        return instant // 2 + instant % 2

    def order(self) -> IntArray:
        """(S,) the first limb of each step."""
        return np.argmax(self.moved, axis=1)


def gait_of(plan: ClimbPlan) -> Gait:
    """The gait of a plan's instants."""
    instants, rounds = plan.instants, plan.rounds
    count, limbs = instants.lifted.shape
    moved = instants.lifted[::2]
    number = np.clip(instants.round[::2], 1, rounds.count)
    is_push = np.arange(count) % 2 == 1

    broken = instants.lifted.any(axis=1) == is_push
    steps = np.repeat(number, 2)
    broken |= instants.round != steps
    if plan.kind == "climb":
        broken |= _not_a_climb(instants.lifted, instants.round)
    else:
        ahead = np.diff(number, prepend=0)  # every round has a step, and they come in turn
        broken |= np.repeat((ahead < 0) | (ahead > 1), 2)
        broken[-1] |= number[-1] != rounds.count

    placed = np.where(moved, number[:, None], 0)
    stood = np.zeros((count, limbs), np.int64)
    after = np.maximum.accumulate(placed, axis=0)
    stood[1::2] = after
    stood[2::2] = after[:-1]
    com, rpy = _stations(rounds, number)
    shift = np.zeros((len(number), 3))
    if plan.limits.shift_max > 0:
        # Where the body waits for a lift is the plan's own choice, bounded by `steps.shift`
        shift = np.asarray(instants.com[::2] - com[:-1])
        com[:-1] += shift
    return Gait(moved, number, stood, com, rpy, shift, broken)


def _not_a_climb(lifted: BoolArray, number: IntArray) -> BoolArray:
    """(K,) instants at odds with one limb a step, each once a round, always in the same order."""
    count, limbs = lifted.shape
    step = np.arange(count) // 2
    is_push = np.arange(count) % 2 == 1
    order = np.argmax(lifted[::2], axis=1)
    broken = lifted.sum(axis=1) != np.where(is_push, 0, 1)
    first = order[:limbs]
    if len(np.unique(first)) != limbs:
        broken[: 2 * limbs] = True
    broken |= (order != first[np.arange(len(order)) % limbs])[step]
    return np.asarray(broken | (number != step // limbs + 1))


def _stations(rounds: Rounds, number: IntArray) -> tuple[Array, Array]:
    """Body poses (S + 1, 3) and (S + 1, 3): of Q steps in a round each takes it 1/Q further."""
    total = np.bincount(number, minlength=rounds.count + 1)
    behind = np.array([int(np.sum(number[: s + 1] == r)) for s, r in enumerate(number)])
    share = np.concatenate([[0.0], number - 1 + behind / total[number]])
    rows = np.arange(rounds.count + 1)

    def along(values: Array) -> Array:
        return np.stack([np.interp(share, rows, column) for column in values.T], axis=-1)

    return along(rounds.com), along(rounds.rpy)
