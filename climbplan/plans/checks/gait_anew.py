"""The gait that a plan's instants follow, counted from which limb is in the air when."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from climbplan.plans.checks.check import Array
from climbplan.plans.climb_plan import Index, Instants, Mask, Rounds


@dataclass(frozen=True)
class Gait:
    """K instants, two for each step: limb lifted, then limb placed and body pushed."""

    order: Index  # (K/2,) the limb of each step
    placements: Index  # (K, N) how often each limb was placed, the instant included
    com: Array  # (K, 3) where the body is to be
    rpy: Array  # (K, 3)
    broken: Mask  # (K,) not exactly one limb lifted, out of turn, or of another round


def gait_of(instants: Instants, rounds: Rounds) -> Gait:
    """The gait of an instant sequence; K = 2 N M."""
    count, limbs = instants.lifted.shape
    step = np.arange(count) // 2
    is_push = np.arange(count) % 2 == 1
    order = np.argmax(instants.lifted[::2], axis=1)

    placed = np.zeros((count, limbs), np.int64)
    placed[is_push, order] = 1
    placements = np.minimum(placed.cumsum(axis=0), rounds.count)

    broken = instants.lifted.sum(axis=1) != np.where(is_push, 0, 1)
    # Every limb moves once a round, always in the same order.
    first = order[:limbs]
    if len(np.unique(first)) != limbs:
        broken[: 2 * limbs] = True
    broken |= (order != first[np.arange(len(order)) % limbs])[step]
    broken |= instants.round != step // limbs + 1

    com, rpy = body_stations(rounds, limbs)
    station = step + is_push
    return Gait(order, placements, com[station], rpy[station], broken)


def body_stations(rounds: Rounds, limbs: int) -> tuple[Array, Array]:
    """Body poses (N M + 1, 3) and (N M + 1, 3) between pushes: 1/N of a round further each."""
    share = np.arange(limbs * rounds.count + 1) / limbs
    rows = np.arange(rounds.count + 1)

    def along(values: Array) -> Array:
        return np.stack([np.interp(share, rows, column) for column in values.T], axis=-1)

    return along(rounds.com), along(rounds.rpy)
