"""Whether legs hold a robot between walls while any one of them is in the air, and how hard it is.

For each leg lifted the least share s of the torque limits with which the others hold the weight:

    minimise    s + level shift of the body
    such that   sum f = W,   sum p x f - d x W = 0,   |J^T f| <= s tau
                forces in pyramids inside the friction cones, and of some pressure

a linear program, with the Jacobians of the unshifted body (`holding_share`), or of the body where
it is shifted to, in a few programs after one another (`moved_share`). The planner of forces knows
more than this (compliance, commands, stability); it has the last word.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import linprog

from climbplan.arrays import Array
from climbplan.robots.serial_chain import SerialChain

_FACETS = 8
_PRESS = 0.05  # of the weight, at every toe
_MOVES = 5  # programs after one another, each with the Jacobians of the last one's shift
_HALVED = 4  # times that a shift is halved whose toes are out of reach
_TRUST = 0.05  # [m] to which Jacobians are trusted from the second program on
_STILL = 2e-3  # [m]
_SHIFT_COST = 2.0  # [1/m] share of torque that a metre of shift has to save


@dataclass(frozen=True)
class Lack:
    """The least share of the torque limits that any posture needs, and what is missing for it."""

    share: float = np.nan  # above 1 where none holds; infinite by friction, NaN: none in reach
    limb: int = 0
    joint: int = 0  # of that limb, that needs the largest share
    torque: float = 0.0  # of it [N m]


def lack_of(
    share: float,
    toes: Array,
    normal: Array,
    jacobian: Array,
    torque: Array,
    weight: float,
    mu: float,
    most: float,
) -> Lack:
    """The joint that is at `share` of its limit in a posture; arguments as of `holding_share`."""
    worst, most_used = Lack(share), 0.0
    for stands, found in _lifts(toes, normal, jacobian, torque, weight, mu, most):
        if found is None:
            continue
        force = weight * found[2].reshape(-1, 3)
        needed = np.abs(np.einsum("nij,ni->nj", jacobian[stands], force))
        used = needed / torque[stands]
        limb, joint = (int(k) for k in np.unravel_index(int(np.argmax(used)), used.shape))
        if used[limb, joint] > most_used:
            most_used = float(used[limb, joint])
            worst = Lack(share, stands[limb], joint, float(needed[limb, joint]))
    return worst


def _lifts(
    toes: Array,
    normal: Array,
    jacobian: Array,
    torque: Array,
    weight: float,
    mu: float,
    most: float,
) -> Iterator[tuple[list[int], tuple[float, float, Array, Array] | None]]:
    """Limbs that stand, and what they need, with each limb lifted in turn."""
    for lifted in range(len(toes)):
        stands = [i for i in range(len(toes)) if i != lifted]
        yield (
            stands,
            _least_share(
                toes[stands], normal[stands], jacobian[stands], torque[stands], weight, mu, most
            ),
        )


def holding_share(
    toes: Array,
    normal: Array,
    jacobian: Array,
    torque: Array,
    weight: float,
    mu: float,
    most: float,
) -> tuple[float, float]:
    """The largest share of any lift, and the largest shift [m]; infinite where a lift has none.

    A share above 1 is what the torque limits lack.

    toes, normal: (N, 3) from the centre of mass; jacobian: (N, 3, J); torque: (N, J) [N m]; mu:
    friction coefficient that may be used; most: [m] of shift.
    """
    worst, shift = 0.0, 0.0
    for _, found in _lifts(toes, normal, jacobian, torque, weight, mu, most):
        if found is None:
            return np.inf, np.inf
        worst, shift = max(worst, found[0]), max(shift, found[1])
    return worst, shift


def moved_share(
    chain: SerialChain,
    bounds: tuple[Array, Array],
    angles: Array,
    toes: Array,
    normal: Array,
    torque: Array,
    weight: float,
    mu: float,
    most: float,
    enough: float = np.inf,
) -> tuple[float, float]:
    """As `holding_share`, with exact kinematics of the shifted body: toes stay where they are.

    chain: of the legs; bounds: (N, J) lower and upper [rad]; angles: (N, J) of the unshifted body;
    toes: (N, 3) from its centre of mass, which is taken to move with the body. enough: a share,
    beyond which no further lifts are looked at.
    """
    count = len(toes)
    near = replace(chain, posture=angles)
    hips = near.joint_points(angles[None])[0, :, -1]
    worst, shift = 0.0, 0.0
    for lifted in range(count):
        stands = [i for i in range(count) if i != lifted]
        at, jacobian, trust = np.zeros(2), near.jacobian(angles), most
        best: tuple[float, float] | None = None
        for _ in range(_MOVES):
            own = toes[stands], normal[stands], jacobian[stands], torque[stands], weight, mu
            fixed = _least_share(*own, most, at, 0.0)
            if fixed is not None and (best is None or fixed[0] < best[0]):
                best = fixed[0], float(np.abs(at).max())
            else:
                trust *= 0.5
            aim = _least_share(*own, most, at, trust)
            if aim is None:
                break
            step = aim[3] - at
            for _ in range(_HALVED):
                found = near.inverse((hips - [*(at + step), 0.0])[None], *bounds)
                if found.valid[0][stands].all():
                    break
                step = 0.5 * step
            else:
                break
            if np.abs(step).max() < _STILL:
                break
            at = at + step
            jacobian = near.jacobian(np.nan_to_num(found.best()[0]))
            trust = min(trust, _TRUST)
        if best is None:
            return np.inf, np.inf
        worst, shift = max(worst, best[0]), max(shift, best[1])
        if worst > enough:
            break
    return worst, shift


def _least_share(
    toes: Array,
    normal: Array,
    jacobian: Array,
    torque: Array,
    weight: float,
    mu: float,
    most: float,
    about: Array | None = None,
    trust: float = np.inf,
) -> tuple[float, float, Array, Array] | None:
    """Share, shift, forces (3 n,) in units of the weight of one stance, and the shift (2,).

    about: shift (2,) from which none is looked for that is farther off than `trust` [m] in x or y.
    Unknowns: forces in units of the weight, s, the shift in x and y, and its size.
    """
    middle = np.zeros(2) if about is None else about
    low, high = np.maximum(-most, middle - trust), np.minimum(most, middle + trust)
    n = len(toes)
    size = 3 * n + 4
    equal = np.zeros((6, size))
    for i in range(n):
        x, y, z = toes[i]
        equal[:3, 3 * i : 3 * i + 3] = np.eye(3)
        equal[3:, 3 * i : 3 * i + 3] = [[0, -z, y], [z, 0, -x], [-y, x, 0]]
    # Toes are at p - d from the shifted body, under the weight's reaction of one: d x (0, 0, 1)
    equal[3, -2], equal[4, -3] = -1.0, 1.0
    right = np.array([0.0, 0.0, 1.0, 0.0, 0.0, 0.0])
    rows: list[Array] = []
    ends: list[Array] = []
    angle = 2 * np.pi * np.arange(_FACETS) / _FACETS
    inner = mu * np.cos(np.pi / _FACETS)
    for i in range(n):
        own = slice(3 * i, 3 * i + 3)
        across = np.cross(normal[i], np.eye(3)[int(np.argmin(np.abs(normal[i])))])
        across /= np.linalg.norm(across)
        along = np.cross(normal[i], across)
        around = np.cos(angle)[:, None] * across + np.sin(angle)[:, None] * along
        pyramid = np.zeros((_FACETS, size))
        pyramid[:, own] = around - inner * normal[i]
        press = np.zeros((1, size))
        press[0, own] = -normal[i]
        turn = np.zeros((2 * jacobian.shape[2], size))
        share = weight * jacobian[i].T / torque[i][:, None]
        turn[:, own] = np.concatenate([share, -share])
        turn[:, 3 * n] = -1.0
        rows += [pyramid, press, turn]
        ends += [np.zeros(_FACETS), np.array([-_PRESS]), np.zeros(len(turn))]
    for column, sign in itertools.product((-3, -2), (1.0, -1.0)):
        row = np.zeros((1, size))
        row[0, column], row[0, -1] = sign, -1.0
        rows.append(row)
        ends.append(np.zeros(1))
    cost = np.zeros(size)
    cost[3 * n], cost[-1] = 1.0, _SHIFT_COST
    bounds = [(None, None)] * (3 * n) + [(0.0, None), *zip(low, high, strict=True), (0.0, most)]
    found = linprog(cost, np.vstack(rows), np.concatenate(ends), equal, right, bounds)
    if found.status != 0:
        return None
    shift = np.asarray(found.x[3 * n + 1 : 3 * n + 3])
    return float(found.x[3 * n]), float(found.x[-1]), np.asarray(found.x[: 3 * n]), shift
