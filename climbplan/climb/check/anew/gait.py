"""The gait of a plan's instants, reconstructed from which limbs are in the air.

Instants come in pairs, two for each step: limbs lifted, then limbs placed and the body pushed on.
In a climb every round moves each limb once, one per step and always in the same order. In a
transition a round has any number of steps, each of one limb or more.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from climbplan.arrays import Array, BoolArray, IntArray
from climbplan.climb.plan.climb_plan import ClimbPlan, Rounds


@dataclass(frozen=True)
class ClimbGait:
    """The gait of K instants in S = K / 2 steps."""

    moving_limbs: BoolArray  # (S, N) the limbs of each step
    round: IntArray  # (S,) the round of each step, 1..M
    foothold_round: (
        IntArray  # (K, N) the round whose foothold each limb is on, or left; 0 for the start
    )
    station_com: Array  # (S + 1, 3) where the body waits before each step and after the last
    station_rpy: Array  # (S + 1, 3)
    shift: Array  # (S, 3) of these off the straight way, zero where plans may not leave it
    is_invalid: BoolArray  # (K,) limbs lifted where none or some should be, out of turn or round

    @property
    def steps(self) -> int:
        """Return the number of steps S."""
        return len(self.moving_limbs)

    @property
    def com(self) -> Array:
        """Return where the body should be at the instants (K, 3) [m]."""
        return self.station_com[self._station]

    @property
    def rpy(self) -> Array:
        """Return the angles that the body should have at the instants (K, 3) [rad]."""
        return self.station_rpy[self._station]

    @property
    def _station(self) -> IntArray:
        instant = np.arange(2 * self.steps)
        return instant // 2 + instant % 2

    def order(self) -> IntArray:
        """Return the first limb of each step (S,)."""
        return np.argmax(self.moving_limbs, axis=1)


def reconstruct_gait(plan: ClimbPlan) -> ClimbGait:
    """Reconstruct the gait of a plan's instants."""
    instants, rounds = plan.instants, plan.rounds
    count, limbs = instants.lifted.shape
    moving_limbs = instants.lifted[::2]
    step_rounds = np.clip(instants.round[::2], 1, rounds.count)
    is_push = np.arange(count) % 2 == 1

    is_invalid = instants.lifted.any(axis=1) == is_push
    instant_rounds = np.repeat(step_rounds, 2)
    is_invalid |= instants.round != instant_rounds
    if plan.kind == "climb":
        is_invalid |= _find_climb_violations(instants.lifted, instants.round)
    else:
        round_change = np.diff(
            step_rounds, prepend=0
        )  # every round has a step, and they come in turn
        is_invalid |= np.repeat((round_change < 0) | (round_change > 1), 2)
        is_invalid[-1] |= step_rounds[-1] != rounds.count

    placed = np.where(moving_limbs, step_rounds[:, None], 0)
    foothold_round = np.zeros((count, limbs), np.int64)
    latest_round = np.maximum.accumulate(placed, axis=0)
    foothold_round[1::2] = latest_round
    foothold_round[2::2] = latest_round[:-1]
    com, rpy = _interpolate_stations(rounds, step_rounds)
    shift = np.zeros((len(step_rounds), 3))
    if plan.limits.shift_max > 0:
        # Where the body waits for a lift is the plan's own choice, bounded by `steps.shift`
        shift = np.asarray(instants.com[::2] - com[:-1])
        com[:-1] += shift
    return ClimbGait(moving_limbs, step_rounds, foothold_round, com, rpy, shift, is_invalid)


def _find_climb_violations(lifted: BoolArray, instant_rounds: IntArray) -> BoolArray:
    """Return instants (K,) that violate one limb per step, each once per round, always in one
    order.
    """
    count, limbs = lifted.shape
    step = np.arange(count) // 2
    is_push = np.arange(count) % 2 == 1
    order = np.argmax(lifted[::2], axis=1)
    is_invalid = lifted.sum(axis=1) != np.where(is_push, 0, 1)
    first = order[:limbs]
    if len(np.unique(first)) != limbs:
        is_invalid[: 2 * limbs] = True
    is_invalid |= (order != first[np.arange(len(order)) % limbs])[step]
    return np.asarray(is_invalid | (instant_rounds != step // limbs + 1))


def _interpolate_stations(rounds: Rounds, step_rounds: IntArray) -> tuple[Array, Array]:
    """Return body poses (S + 1, 3) and (S + 1, 3): each of Q steps in a round moves the body by
    1/Q.
    """
    steps_per_round = np.bincount(step_rounds, minlength=rounds.count + 1)
    steps_done = np.array(
        [int(np.sum(step_rounds[: s + 1] == r)) for s, r in enumerate(step_rounds)]
    )
    progress = np.concatenate([[0.0], step_rounds - 1 + steps_done / steps_per_round[step_rounds]])
    rows = np.arange(rounds.count + 1)

    def interpolate(values: Array) -> Array:
        return np.stack([np.interp(progress, rows, column) for column in values.T], axis=-1)

    return interpolate(rounds.com), interpolate(rounds.rpy)
