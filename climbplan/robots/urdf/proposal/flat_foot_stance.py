"""Search for stances of a biped on two flat feet, each of which holds it while the other steps.

Soles lie level under the hips, toes forward, with the centre of mass over the line between their
middles. The legs are bent by different amounts. A posture is feasible if the body can shift over
either sole with both still standing, the motors of that leg holding the whole weight. Candidates
are ranked by the margin about the toes with soles kept level, times the unused torque.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from climbplan.arrays import Array, BoolArray
from climbplan.robots.pose_inverse import pose_inverse
from climbplan.robots.serial_chain import SerialChain
from climbplan.robots.urdf.proposal.postures import (
    MIN_REACH_MARGIN,
    LeggedPosture,
    LegModel,
    are_clear_of_body,
)
from climbplan.robots.urdf.proposal.soles import Soles

_LOWERINGS = np.arange(0.70, 0.96, 0.04)  # fractions of reach, soles below hips
_OUTWARD_OFFSETS = np.array([0.0, 0.03, 0.06])  # fractions of reach
_MIN_SOLE_GAP = 0.02  # [m] between soles
_NUM_SAMPLES = 4000  # postures of a leg
_NUM_STARTS = 24  # nearest samples from which inverse kinematics starts, for each toe
_TILT_WEIGHT = 0.3  # [m/rad] of a sole off level, in the distance to a sample
_NUM_CENTERING_STEPS = 4  # fixed-point steps that move the feet under the centre of mass
_MAX_JOINT_CHANGE = 0.5  # [rad] to which the first order is trusted


def search_flat_foot_stances(
    legs: LegModel, soles: Soles, compute_center: Callable[[Array], Array]
) -> list[LeggedPosture]:
    """Return postures of two legs, best first; toes in the frame of the chains.

    Args:
        legs: Chains whose toes are the middles of soles.
        soles: The flat feet.
        compute_center: Centre of mass (3,) at angles (N, J), frame of the chains [m].
    """
    level = np.swapaxes(soles.axes_zero, -1, -2)
    low, out = (x.ravel() for x in np.meshgrid(_LOWERINGS, _OUTWARD_OFFSETS, indexing="ij"))
    reach, hips, sign = legs.reach, legs.hips, legs.outward_signs
    lateral = np.maximum(np.abs(hips[:, 0]), (soles.width + _MIN_SOLE_GAP) / 2)
    toes = np.empty((len(low), len(hips), 3))
    toes[..., 0] = sign[:, 0] * (lateral + out[:, None] * reach)
    toes[..., 1] = hips[:, 1].mean()
    toes[..., 2] = (hips[:, 2] - low[:, None] * reach).max(axis=1)[:, None]
    starts = _solve_leg_angles(legs, toes, level)
    stances = []
    for start, positions in zip(starts, toes, strict=True):
        posture = _center_over_feet(legs, level, compute_center, start, positions)
        if posture is not None:
            stances.append(posture)
    return sorted(stances, key=lambda posture: -posture.score)


def _solve_leg_angles(legs: LegModel, toes: Array, level: Array) -> Array:
    """Return angles (C, N, J) [rad] that put level soles at toes (C, N, 3), NaN where none do.

    level: rotations (N, 3, 3) of last links with which soles are level. Mirrored legs bend alike.
    """
    chain, count = legs.chain, toes.shape[1]
    low, high = np.clip(legs.lower, -np.pi, np.pi), np.clip(legs.upper, -np.pi, np.pi)
    fraction = np.random.default_rng(0).random((_NUM_SAMPLES, *legs.lower.shape))
    samples = low + fraction * (high - low)
    pose = chain.pose(samples)
    tilt = np.linalg.norm(pose.turns[:, :, -1] - level, axis=(-1, -2))  # (F, N)
    angles = np.zeros((*toes.shape[:2], legs.lower.shape[1]))
    for candidate, positions in enumerate(toes):
        for limb in range(count):
            distance = np.linalg.norm(pose.toe[:, limb] - positions[limb], axis=-1)
            distance = distance + _TILT_WEIGHT * tilt[:, limb]
            rows = np.argsort(distance, kind="stable")[:_NUM_STARTS]
            leg = np.full(len(rows), limb)
            solution = pose_inverse(
                chain.zero.rows(leg),
                samples[rows, limb],
                np.broadcast_to(positions[limb], (len(rows), 3)),
                np.broadcast_to(level[limb], (len(rows), 3, 3)),
                legs.lower[leg],
                legs.upper[leg],
            )
            angles[candidate, limb] = _select_solution(
                legs, limb, angles[candidate], solution.angles, solution.reached
            )
    return angles


def _select_solution(
    legs: LegModel, limb: int, angles: Array, solutions: Array, reached: BoolArray
) -> Array:
    """Return the solution of one leg that mirrors the other leg, else the farthest from bounds.

    angles: (N, J) of legs solved so far; solutions: (S, J); reached: (S,). NaN where none is
    reached.
    """
    if not reached.any():
        return np.full(solutions.shape[1], np.nan)
    solutions = solutions[reached]
    twin = legs.mirrored_legs[limb]
    if twin is not None and twin < limb:
        image = legs.chain.joint_points(angles)[twin] * [-1.0, 1.0, 1.0]
        complete = np.repeat(angles[None], len(solutions), axis=0)
        complete[:, limb] = solutions
        offset = legs.chain.joint_points(complete)[:, limb] - image
        return np.asarray(solutions[int(np.argmin(np.linalg.norm(offset, axis=-1).sum(-1)))])
    margin = np.minimum(solutions - legs.lower[limb], legs.upper[limb] - solutions).min(axis=-1)
    return np.asarray(solutions[int(np.argmax(margin))])


def _center_over_feet(
    legs: LegModel,
    level: Array,
    compute_center: Callable[[Array], Array],
    angles: Array,
    toes: Array,
) -> LeggedPosture | None:
    """Return the posture with its feet under its centre of mass; None where it is infeasible."""
    if not np.isfinite(angles).all():
        return None
    toes = toes.copy()
    for _ in range(_NUM_CENTERING_STEPS):
        toes[:, 1] = compute_center(angles)[1]
        chain = replace(legs.chain, posture=angles)
        solution = chain.inverse(toes, legs.lower, legs.upper, level)
        if not solution.valid.all():
            return None
        angles = solution.best()
    chain = replace(legs.chain, posture=angles)
    if not are_clear_of_body(legs, chain.joint_points(angles[None])).all():
        return None
    center = compute_center(angles)
    utilisation = _compute_single_support_utilisation(legs, chain, level, toes, center)
    if utilisation is None:
        return None
    margin = float(_compute_level_margin(legs, chain, angles).min())
    if utilisation >= 1 or margin < MIN_REACH_MARGIN:
        return None
    shift = float(np.abs(toes[:, 0] - center[0]).max())
    return LeggedPosture(angles, toes, margin * (1 - utilisation), margin, utilisation, shift=shift)


def _compute_single_support_utilisation(
    legs: LegModel, chain: SerialChain, level: Array, toes: Array, center: Array
) -> float | None:
    """Return the largest torque fraction with the body over either sole; None if out of reach."""
    utilisation = 0.0
    for limb in range(len(toes)):
        shifted_toes = toes - [float(toes[limb, 0] - center[0]), 0.0, 0.0]
        solution = chain.inverse(shifted_toes, legs.lower, legs.upper, level)
        if not solution.valid.all():
            return None
        jacobian = chain.jacobian(solution.best())[limb]
        fraction = np.abs(legs.weight * jacobian[2]) / legs.torque[limb]
        utilisation = max(utilisation, float(fraction.max()))
    return utilisation


def _compute_level_margin(legs: LegModel, chain: SerialChain, angles: Array) -> Array:
    """Return the radius (N,) of the reachable ball about each toe, sole level, first order [m]."""
    rows = np.concatenate([chain.jacobian(angles), chain.turning(angles)], axis=-2)
    inverse = np.linalg.pinv(rows)[..., :3]  # (N, J, 3)
    rate = np.linalg.norm(inverse, axis=-1)
    bound_margin = np.minimum(angles - legs.lower, legs.upper - angles)
    margin = np.where(rate > 0, bound_margin / np.maximum(rate, 1e-9), np.inf).min(axis=-1)
    smallest = 1.0 / np.linalg.norm(inverse, axis=(-1, -2), ord=2)
    return np.asarray(np.minimum(margin, _MAX_JOINT_CHANGE * smallest))
