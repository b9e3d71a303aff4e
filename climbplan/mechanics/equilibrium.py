"""Equilibrium of point contacts (chapter 4.2, eqs. (4.15) and (4.16)).

Equation and chapter numbers are those of X. Lin (UCLA 2022).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from climbplan.arrays import Array, IntArray
from climbplan.robots.model import Robot
from climbplan.robots.rotations import rotation_world_body, skew
from climbplan.robots.serial_chain import SerialChain

_RANK_TOLERANCE = 1e-8  # of the largest singular value; collinear contacts end near 1e-16


def total_load(robot: Robot, external_wrench: Array, rpy: Array, angles: Array) -> Array:
    """Return the weight, which acts in the centre of mass, plus an external wrench (..., 6).

    Args:
        robot: The robot.
        external_wrench: Force and moment about the body origin (..., 6) [N, N m], world frame.
        rpy: (..., 3) [rad].
        angles: Joint angles (..., N, J) [rad].
    """
    weight = np.array([0.0, 0.0, -robot.weight, 0.0, 0.0, 0.0])
    load = np.asarray(external_wrench + weight)
    if robot.links is not None:
        load[..., 3:] += weight_moment(robot, rpy, angles)
    return load


def weight_moment(robot: Robot, rpy: Array, angles: Array) -> Array:
    """Return the moment (..., 3) of the weight about the body origin [N m], world frame.

    rpy: (..., 3) [rad]; angles: (..., N, J).
    """
    arm = (rotation_world_body(rpy) @ robot.centre_of_mass(angles)[..., None])[..., 0]
    return np.cross(arm, [0.0, 0.0, -robot.weight])


def link_torques(robot: Robot, rpy: Array, angles: Array) -> Array:
    """Return torques (..., N, J) of the links' own weight [N m], in addition to J^T f.

    rpy: (..., 3) [rad]; angles: (..., N, J). Zero where limbs weigh nothing.
    """
    if robot.links is None or not isinstance(robot.mechanism, SerialChain):
        return np.zeros(angles.shape)
    down = -robot.gravity * rotation_world_body(rpy)[..., 2, :]
    return robot.links.torques(robot.mechanism, angles, down)


def grasp_matrix(arms: Array) -> Array:
    """Return G with [sum f; sum r x f] = G [f_1; ...; f_n], eqs. (4.15) and (4.16).

    arms: (..., n, 3) from the body origin to the contacts [m]. Returns (..., 6, 3 n).
    """
    *batch, n, _ = arms.shape
    grasp = np.empty((*batch, 6, n, 3))
    grasp[..., :3, :, :] = np.eye(3)[:, None, :]
    grasp[..., 3:, :, :] = np.moveaxis(skew(arms), -3, -2)
    return grasp.reshape(*batch, 6, 3 * n)


def wrench_of(arms: Array, force: Array) -> Array:
    """Return the sum of forces and of their moments: (..., n, 3) arms and forces to (..., 6)."""
    return np.concatenate([force.sum(axis=-2), np.cross(arms, force).sum(axis=-2)], axis=-1)


@dataclass(frozen=True)
class Balance:
    """All contact forces that balance a load: f = particular + null_space y."""

    particular: Array  # (B, 3 n) least-norm forces [N]
    null_space: Array  # (B, 3 n, q) orthonormal columns
    rank: IntArray  # (B,) 6, or less if the contacts cannot resist every load
    residual: Array  # (B,) part of the load that no contact forces balance [N], 0 at full rank


def balance_load(arms: Array, load: Array, length: float) -> list[tuple[IntArray, Balance]]:
    """Return the contact forces that balance loads, for instants with equally many contacts.

    On two contacts, or on contacts in a line, one moment component cannot be resisted.

    Args:
        arms: (B, n, 3) [m].
        load: (B, 6) on the body [N, N m].
        length: Scale [m] that makes moments comparable with forces.

    Returns:
        Pairs of indices into the batch and their Balance, one pair for each rank that occurs.
    """
    scale = np.array([1.0] * 3 + [1 / length] * 3)
    grasp = grasp_matrix(arms) * scale[:, None]
    need = -load * scale
    left, sigma, right = np.linalg.svd(grasp, full_matrices=True)
    rank = (sigma > _RANK_TOLERANCE * sigma[:, :1]).sum(axis=1)
    balances = []
    for r in np.unique(rank):
        rows = np.flatnonzero(rank == r)
        components = np.einsum("bij,bi->bj", left[rows], need[rows])  # load along the left vectors
        particular = np.einsum("brk,br->bk", right[rows, :r], components[:, :r] / sigma[rows, :r])
        residual = np.linalg.norm(components[:, r:], axis=1)
        null_space = np.swapaxes(right[rows, r:], 1, 2)
        balances.append((rows, Balance(particular, null_space, rank[rows], residual)))
    return balances
