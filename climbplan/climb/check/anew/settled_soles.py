"""Chains that end in flat feet which the terrain holds: what their joints settle to."""

from __future__ import annotations

import numpy as np

from climbplan.arrays import Array
from climbplan.climb.check.anew.chains import SettledChains, chain_turned, chains_at
from climbplan.robots.foot import Sole
from climbplan.robots.serial_chain import SerialChain

_ITERATIONS = 60
_LONGEST = 0.2  # [rad] of a step
_STILL = 1e-13  # [rad] of the last step
_SLIGHT = 1e-14  # give, by which singular limbs have an answer


def settled_soles(
    chain: SerialChain,
    sole: Sole,
    toes: Array,
    axes: Array,
    alike: Array,
    command: Array,
    spring: Array,
) -> SettledChains:
    """Angles near `alike` (..., N, J) with soles at toes (..., N, 3), rows axes (..., N, 3, 3).

    Body frame. Of limbs of more than six joints those of least energy: k (q - command) = J^T w for
    angles q, and force and moment w, by Newton's method.
    """
    rows = np.swapaxes(sole.axes_zero, -1, -2)
    count = alike.shape[-1]
    q, wrench = alike.copy(), np.zeros((*alike.shape[:-1], 6))
    matrix = np.zeros((*alike.shape[:-1], count + 6, count + 6))
    matrix[..., :count, :count] = spring[:, None, :] * np.eye(count)
    matrix[..., count:, count:] = _SLIGHT * np.eye(6)
    for _ in range(_ITERATIONS):
        limbs = chains_at(chain, q)
        own = np.swapaxes(limbs.axes, -1, -2)
        turning = own if limbs.drive is None else own @ limbs.drive
        held = np.concatenate([limbs.jacobian(), turning], axis=-2)
        here = np.stack([chain_turned(chain, q, rows[:, k]) for k in range(3)], axis=-2)
        off = np.concatenate([toes - limbs.toe, np.cross(here, axes).sum(axis=-2) / 2], axis=-1)
        matrix[..., :count, count:] = -np.swapaxes(held, -1, -2)
        matrix[..., count:, :count] = held
        pull = (np.swapaxes(held, -1, -2) @ wrench[..., None])[..., 0] - spring * (q - command)
        right = np.concatenate([pull, off], axis=-1)
        step = np.asarray(np.linalg.solve(matrix, right[..., None])[..., 0], np.float64)
        most = np.abs(step[..., :count]).max(axis=-1, keepdims=True)
        step = step * np.minimum(1.0, _LONGEST / np.maximum(most, 1e-300))
        q = q + step[..., :count]
        wrench = wrench + step[..., count:]
        if not (most > _STILL).any():
            break
    limbs = chains_at(chain, q)
    here = np.stack([chain_turned(chain, q, rows[:, k]) for k in range(3)], axis=-2)
    tilted = np.linalg.norm(here - axes, axis=-1).max(axis=-1)  # one radian counts as one metre
    return SettledChains(q, np.maximum(np.linalg.norm(toes - limbs.toe, axis=-1), tilted))
