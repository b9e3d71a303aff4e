"""Chains of joints built anew from what the plan file says of them: poses, and what they settle to.

A chain is moved from its toe inwards, joint by joint, each about or along where it is at zero
angles; a joint that follows others moves by what the file says of their angles. Where
a limb has more than three joints, a toe that is held leaves it free to move: its joints, springs
about their commands, settle where their energy is least.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from climbplan.arrays import Array, BoolArray
from climbplan.robots.serial_chain import SerialChain

_ITERATIONS = 40
_LONGEST = 0.3  # [rad] of a Newton step, and [m]
_STILL = 1e-13  # [rad] of the last step
_RESTS = 1e-6  # [rad] of the last step, beyond which a limb has not settled
_HELD = 1e-7  # [m] of a toe from its place
_SLIGHT = 1e-14  # [m/N] give of the toe, by which singular limbs have an answer


@dataclass(frozen=True)
class ChainLimbs:
    """Chains in the body frame."""

    joints: Array  # (..., N, J, 3) [m]
    axes: Array  # (..., N, J, 3) of joints that turn, zero of others
    toe: Array  # (..., N, 3) [m]
    slides: Array  # (..., N, J, 3) directions of joints that slide, zero of others
    drive: Array | None  # (N, J, J) how far joints move by angles, unless each by its own

    def columns(self) -> Array:
        """(..., N, J, 3) velocity of the toe by the speed of each joint by itself."""
        return np.cross(self.axes, self.toe[..., None, :] - self.joints) + self.slides

    def jacobian(self) -> Array:
        """(..., N, 3, J)."""
        own = np.swapaxes(self.columns(), -1, -2)
        return own if self.drive is None else own @ self.drive

    def bending(self, force: Array) -> Array:
        """(..., N, J, J) Hessian of force . toe by the angles, for forces (..., N, 3)."""
        columns = self.columns()
        # f . (a_i x c_j) for i <= j, mirrored
        upper = np.einsum("...id,...jd->...ij", np.cross(force[..., None, :], self.axes), columns)
        upper = np.triu(upper)
        whole = np.asarray(upper + np.swapaxes(np.triu(upper, 1), -1, -2))
        if self.drive is None:
            return whole
        return np.asarray(np.swapaxes(self.drive, -1, -2) @ whole @ self.drive)


def chains_at(chain: SerialChain, angles: Array) -> ChainLimbs:
    """Chains at angles (..., N, J) [rad, or m of joints that slide], body frame."""
    count = angles.shape[-1]
    shape = angles.shape[:-1]
    moved = joint_motions(chain, angles)
    ways = slide_directions(chain)
    slides = np.broadcast_to(ways, (*shape, count, 3)).copy()
    joints = np.broadcast_to(chain.joint_zero, (*shape, count, 3)).copy()
    axes = np.broadcast_to(chain.axis_zero, (*shape, count, 3)).copy()
    toe = np.broadcast_to(chain.toe_zero, (*shape, 3)).copy()
    for j in reversed(range(count)):
        about, axis = chain.joint_zero[:, j], chain.axis_zero[:, j]
        angle = moved[..., j]
        along = angle[..., None] * ways[:, j]
        toe = about + _turned(toe - about, axis, angle) + along
        for later in range(j + 1, count):
            turned = _turned(joints[..., later, :] - about, axis, angle)
            joints[..., later, :] = about + turned + along
            axes[..., later, :] = _turned(axes[..., later, :], axis, angle)
            slides[..., later, :] = _turned(slides[..., later, :], axis, angle)
    return ChainLimbs(joints, axes, toe, slides, chain.drive)


def points_of_links(chain: SerialChain, angles: Array, points: Array) -> Array:
    """Points (N, J, 3) of links at zero angles, moved with them by angles (..., N, J)."""
    moved, ways = joint_motions(chain, angles), slide_directions(chain)
    out = np.broadcast_to(points, (*angles.shape, 3)).copy()
    for j in reversed(range(angles.shape[-1])):
        about, axis = chain.joint_zero[:, j], chain.axis_zero[:, j]
        angle = moved[..., j]
        for link in range(j, angles.shape[-1]):
            turned = _turned(out[..., link, :] - about, axis, angle)
            out[..., link, :] = about + turned + angle[..., None] * ways[:, j]
    return out


def joint_motions(chain: SerialChain, angles: Array) -> Array:
    """How far joints (..., N, J) are moved by angles (..., N, J): by their own, if none follows."""
    if chain.drive is None:
        return angles
    return np.einsum("nij,...nj->...ni", chain.drive, angles)


def slide_directions(chain: SerialChain) -> Array:
    """(N, J, 3) in which joints slide at zero angles, zero of those that do not."""
    return np.zeros_like(chain.axis_zero) if chain.slide_zero is None else chain.slide_zero


def turned_back(chain: SerialChain, angles: Array, vectors: Array) -> Array:
    """Vectors (..., N, 3) of last links at angles (..., N, J), turned with them to zero angles."""
    moved = joint_motions(chain, angles)
    for j in range(moved.shape[-1]):
        vectors = _turned(vectors, chain.axis_zero[:, j], -moved[..., j])
    return vectors


def chain_turned(chain: SerialChain, angles: Array, vectors: Array) -> Array:
    """Vectors (..., N, 3) of last links at zero angles, turned with them by angles (..., N, J)."""
    moved = joint_motions(chain, angles)
    for j in reversed(range(moved.shape[-1])):
        vectors = _turned(vectors, chain.axis_zero[:, j], moved[..., j])
    return vectors


@dataclass(frozen=True)
class SettledChains:
    """Chains whose toes are held."""

    angles: Array  # (..., N, J) [rad]
    missing: Array  # (..., N) distance of the toes from their places [m]


def settled_chains(
    chain: SerialChain,
    toes: Array,
    alike: Array,
    command: Array,
    spring: Array,
    arm: Array | None = None,
) -> SettledChains:
    """Angles near `alike` (..., N, J) with toes at (..., N, 3), body frame, and least energy.

    arm: (..., N, 3) from toes to where forces act on feet of finite size; none: on the toes.

    spring: (N, J) of joints about `command` (..., N, J). Newton's method on k (q - command) = J^T f
    and toe(q) = x for angles q and toe forces f; the energy counts where a limb has a choice.
    Where a body that moves on has left the limb far from `alike`, so that this leads nowhere, it
    starts from the command, which moves with the body.
    """
    found, rests = _settled(chain, toes, alike, command, spring, arm)
    lost = ~rests | (found.missing > _HELD)
    rows = np.asarray(lost.any(axis=-1))  # (...), some limb of which is lost
    if not rows.any():
        return found
    again, rests = _settled(
        _chains_of_rows(chain, rows),
        toes[rows],
        command[rows],
        command[rows],
        spring,
        None if arm is None else arm[rows],
    )
    better = lost[rows] & rests & (again.missing <= _HELD)
    found.angles[rows] = np.where(better[..., None], again.angles, found.angles[rows])
    found.missing[rows] = np.where(better, again.missing, found.missing[rows])
    return found


def _chains_of_rows(chain: SerialChain, rows: BoolArray) -> SerialChain:
    """Chains of the rows (...) that are true, where a chain ends elsewhere in each row.

    Chains whose feet roll have a toe (..., N, 3) for each row; others have one (N, 3) for all.
    """
    if chain.toe_zero.ndim == 2:
        return chain
    toes = np.broadcast_to(chain.toe_zero, (*rows.shape, *chain.toe_zero.shape[-2:]))
    return replace(chain, toe_zero=toes[rows])


def _settled(
    chain: SerialChain,
    toes: Array,
    start: Array,
    command: Array,
    spring: Array,
    arm: Array | None,
) -> tuple[SettledChains, BoolArray]:
    """Newton's method from angles `start` (..., N, J), and where it has come to rest (..., N)."""
    shape, count = start.shape, start.shape[-1]
    q = start.copy()
    limbs = chains_at(chain, q)
    jacobian = limbs.jacobian()
    pressed_at = _pressed_at(limbs, arm)
    give = jacobian / spring[:, None, :] @ np.swapaxes(jacobian, -1, -2) + _SLIGHT * np.eye(3)
    pressed = np.linalg.solve(give, (jacobian @ (q - command)[..., None]))
    force = np.asarray(pressed[..., 0], np.float64)
    matrix = np.zeros((*shape[:-1], count + 3, count + 3))
    matrix[..., count:, count:] = _SLIGHT * np.eye(3)
    for _ in range(_ITERATIONS):
        transposed = np.swapaxes(pressed_at.jacobian(), -1, -2)
        matrix[..., :count, :count] = spring[:, None, :] * np.eye(count) - pressed_at.bending(force)
        matrix[..., :count, count:] = -transposed
        matrix[..., count:, :count] = jacobian
        pull = (transposed @ force[..., None])[..., 0] - spring * (q - command)
        right = np.concatenate([pull, toes - limbs.toe], axis=-1)
        step = np.asarray(np.linalg.solve(matrix, right[..., None])[..., 0], np.float64)
        most = np.abs(step[..., :count]).max(axis=-1, keepdims=True)
        step = step * np.minimum(1.0, _LONGEST / np.maximum(most, 1e-300))
        q = q + step[..., :count]
        force = force + step[..., count:]
        limbs = chains_at(chain, q)
        jacobian = limbs.jacobian()
        pressed_at = _pressed_at(limbs, arm)
        if not (most > _STILL).any():
            break
    missing = np.linalg.norm(toes - limbs.toe, axis=-1)
    return SettledChains(q, missing), np.asarray(most[..., 0] <= _RESTS)


def _pressed_at(limbs: ChainLimbs, arm: Array | None) -> ChainLimbs:
    """Limbs with the points at which forces act in place of their toes."""
    return limbs if arm is None else replace(limbs, toe=limbs.toe + arm)


def turned_about(points: Array, about: Array, axis: Array, angle: Array) -> Array:
    """Points (..., 3) turned about a unit axis (3,) through a place (3,), by angles (...) [rad]."""
    return about + _turned(points - about, axis, angle)


def _turned(vector: Array, axis: Array, angle: Array) -> Array:
    """Vectors (..., N, 3) turned about axes (N, 3), unit or zero, by angles (..., N) [rad]."""
    cos, sin = np.cos(angle)[..., None], np.sin(angle)[..., None]
    along = (vector * axis).sum(axis=-1, keepdims=True) * axis
    there = (axis * axis).sum(axis=-1, keepdims=True) > 0
    turned = along + cos * (vector - along) + sin * np.cross(axis, vector)
    return np.asarray(np.where(there, turned, vector))
