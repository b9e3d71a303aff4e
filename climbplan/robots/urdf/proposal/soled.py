"""How a biped may stand on two flat feet, one of which has to hold it while the other steps.

Soles lie level under the hips, toes forward, the centre of mass over the line between their
middles; legs are bent by different amounts. A posture counts if the body can go over either sole
with both still standing, the motors of that leg holding the whole weight there. Of these the best
have the most room about the toes with soles kept level, with motors at the least of their limits.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from climbplan.arrays import Array, BoolArray
from climbplan.robots.pose_inverse import pose_inverse
from climbplan.robots.serial_chain import SerialChain
from climbplan.robots.urdf.proposal.postures import LEAST_ROOM, Legs, Posture, clear_of_body
from climbplan.robots.urdf.proposal.soles import Soles

_LOW = np.arange(0.70, 0.96, 0.04)  # shares of reach that soles are below hips
_OUT = np.array([0.0, 0.03, 0.06])  # that they are further out
_BETWEEN = 0.02  # [m] that soles are apart at least
_DRAWN = 4000  # postures of a leg
_STARTS = 24  # of these from which angles are looked for, at each place
_TURN = 0.3  # [m] that a radian off level counts as
_CENTRED = 4  # times that feet are moved under the centre of mass
_TRUST = 0.5  # [rad] to which the first order is trusted
_ONE_BEND = 0.5  # [m] off the mirror image of the other leg, that counts as one metre of room


def soled_postures(legs: Legs, soles: Soles, center: Callable[[Array], Array]) -> list[Posture]:
    """Postures of two legs, best first; toes in the frame of the chains.

    legs: chains whose toes are in the middles of soles; center: centre of mass of angles (N, J).
    """
    level = np.swapaxes(soles.axes_zero, -1, -2)
    low, out = (x.ravel() for x in np.meshgrid(_LOW, _OUT, indexing="ij"))
    reach, hips, sign = legs.reach, legs.hips, legs.outward
    beside = np.maximum(np.abs(hips[:, 0]), (soles.width + _BETWEEN) / 2)
    toes = np.empty((len(low), len(hips), 3))
    toes[..., 0] = sign[:, 0] * (beside + out[:, None] * reach)
    toes[..., 1] = hips[:, 1].mean()
    toes[..., 2] = (hips[:, 2] - low[:, None] * reach).max(axis=1)[:, None]
    start = _bent(legs, toes, level)
    found = []
    for angles, places in zip(start, toes, strict=True):
        posture = _centred(legs, level, center, angles, places)
        if posture is not None:
            found.append(posture)
    return sorted(found, key=lambda one: -one.score)


def _bent(legs: Legs, toes: Array, level: Array) -> Array:
    """Angles (C, N, J) from which soles get to toes (C, N, 3), mirrored legs bent alike."""
    chain, count = legs.chain, toes.shape[1]
    span = np.clip(legs.lower, -np.pi, np.pi), np.clip(legs.upper, -np.pi, np.pi)
    drawn = span[0] + np.random.default_rng(0).random((_DRAWN, *legs.lower.shape)) * (
        span[1] - span[0]
    )
    pose = chain.pose(drawn)
    tilt = np.linalg.norm(pose.turns[:, :, -1] - level, axis=(-1, -2))  # (D, N)
    angles = np.zeros((*toes.shape[:2], legs.lower.shape[1]))
    for c, places in enumerate(toes):
        for limb in range(count):
            off = np.linalg.norm(pose.toe[:, limb] - places[limb], axis=-1) + _TURN * tilt[:, limb]
            rows = np.argsort(off, kind="stable")[:_STARTS]
            same = np.full(len(rows), limb)
            answer = pose_inverse(
                chain.zero.rows(same),
                drawn[rows, limb],
                np.broadcast_to(places[limb], (len(rows), 3)),
                np.broadcast_to(level[limb], (len(rows), 3, 3)),
                legs.lower[same],
                legs.upper[same],
            )
            angles[c, limb] = _chosen(legs, limb, angles[c], answer.angles, answer.reached)
    return angles


def _chosen(legs: Legs, limb: int, before: Array, answers: Array, reached: BoolArray) -> Array:
    """Of answers (S, J) the one bent as the other leg is, else the one farthest from its bounds.

    NaN where none is reached.
    """
    if not reached.any():
        return np.full(answers.shape[1], np.nan)
    answers = answers[reached]
    other = legs.mirror[limb]
    if other is not None and other < limb:
        there = legs.chain.joint_points(before)[other] * [-1.0, 1.0, 1.0]
        own = np.repeat(before[None], len(answers), axis=0)
        own[:, limb] = answers
        off = np.linalg.norm(legs.chain.joint_points(own)[:, limb] - there, axis=-1).sum(-1)
        return np.asarray(answers[int(np.argmin(off))])
    margin = np.minimum(answers - legs.lower[limb], legs.upper[limb] - answers).min(axis=-1)
    return np.asarray(answers[int(np.argmax(margin))])


def _centred(
    legs: Legs, level: Array, center: Callable[[Array], Array], angles: Array, toes: Array
) -> Posture | None:
    """The posture with its feet under its centre of mass; None where it cannot stand so."""
    if not np.isfinite(angles).all():
        return None
    toes = toes.copy()
    for _ in range(_CENTRED):
        toes[:, 1] = center(angles)[1]
        near = replace(legs.chain, posture=angles)
        found = near.inverse(toes, legs.lower, legs.upper, level)
        if not found.valid.all():
            return None
        angles = found.best()
    near = replace(legs.chain, posture=angles)
    if not clear_of_body(legs, near.joint_points(angles[None])).all():
        return None
    use, middle = 0.0, center(angles)
    for limb in range(len(toes)):
        over = toes - [float(toes[limb, 0] - middle[0]), 0.0, 0.0]
        shifted = near.inverse(over, legs.lower, legs.upper, level)
        if not shifted.valid.all():
            return None
        jacobian = near.jacobian(shifted.best())[limb]
        use = max(use, float((np.abs(legs.weight * jacobian[2]) / legs.torque[limb]).max()))
    room = float(_room(legs, near, angles).min())
    if use >= 1 or room < LEAST_ROOM:
        return None
    shift = float(np.abs(toes[:, 0] - middle[0]).max())
    return Posture(angles, toes, room * (1 - use), room, use, shift=shift)


def _room(legs: Legs, chain: SerialChain, angles: Array) -> Array:
    """(N,) ball about a toe that joints reach with the sole kept level, first order [m]."""
    rows = np.concatenate([chain.jacobian(angles), chain.turning(angles)], axis=-2)
    inverse = np.linalg.pinv(rows)[..., :3]  # (N, J, 3)
    size = np.linalg.norm(inverse, axis=-1)
    margin = np.minimum(angles - legs.lower, legs.upper - angles)
    room = np.where(size > 0, margin / np.maximum(size, 1e-9), np.inf).min(axis=-1)
    least = 1.0 / np.linalg.norm(inverse, axis=(-1, -2), ord=2)
    return np.asarray(np.minimum(room, _TRUST * least))
