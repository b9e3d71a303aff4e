"""Terrains of one posture, and the distributions that envelopes are learned on.

One convex patch for each limb, with its normal and friction coefficient: the parameter theta of the
coupled problem. Patches are squares about jittered stances, turned up to 30 degrees (5.2.3).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from climbplan.arrays import Array
from climbplan.climb.envelopes.legs import (
    Legs,
    select_ground_legs,
    select_standing_legs,
    select_wall_legs,
)
from climbplan.errors import UsageError
from climbplan.mechanics.friction import contact_frame
from climbplan.robots.model import Robot

CORNERS = 4  # of a patch


@dataclass(frozen=True)
class LimbPatches:
    """One patch for each of N limbs."""

    vertices: Array  # (N, 4, 3) [m] anticlockwise seen from free space
    normal: Array  # (N, 3) unit, into free space
    friction: Array  # (N,)

    def vector(self) -> Array:
        """Return (N 16,) vertices, normals, friction coefficients: a dataset's row."""
        return np.concatenate([self.vertices.ravel(), self.normal.ravel(), self.friction])

    @classmethod
    def from_vector(cls, row: Array) -> LimbPatches:
        """Return the patches of a dataset's row; raises UsageError for a length that fits none."""
        n, remainder = divmod(len(row), 3 * CORNERS + 4)
        if remainder or not n:
            raise UsageError(
                f"expected {3 * CORNERS + 4} numbers for each limb of a row, got {len(row)}"
            )
        corners = 3 * CORNERS * n
        return cls(
            np.reshape(row[:corners], (n, CORNERS, 3)),
            np.reshape(row[corners : corners + 3 * n], (n, 3)),
            np.asarray(row[corners + 3 * n :]),
        )


@dataclass(frozen=True)
class TerrainDistribution:
    """G(theta): random patches about the stances of some limbs."""

    name: str
    legs: Legs
    normal: Array  # (N, 3) nominal
    friction: tuple[float, float]
    tilt: float = float(np.deg2rad(30.0))  # largest angle from the nominal normal [rad]
    jitter: float = 0.1  # [m] of patch centres along each axis
    half_size: float = 0.05  # [m] of patches

    def sample(self, rng: np.random.Generator) -> LimbPatches:
        """Return one terrain; angles, positions and friction coefficients are uniform."""
        n = self.legs.count
        center = self.legs.stance + rng.uniform(-self.jitter, self.jitter, (n, 3))
        normals = tilt_normals(
            self.normal, rng.uniform(0, self.tilt, n), rng.uniform(0, 2 * np.pi, n)
        )
        frame = contact_frame(normals)
        corner_offsets = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]) * self.half_size
        edges = np.stack([frame.tangent, frame.bitangent], axis=1)  # (N, 2, 3)
        vertices = center[:, None] + corner_offsets @ edges
        return LimbPatches(vertices, normals, rng.uniform(*self.friction, n))


def tilt_normals(normal: Array, angle: Array, about: Array) -> Array:
    """Return unit normals (N, 3) tilted by `angle` (N,) towards the direction `about` (N,)."""
    frame = contact_frame(normal)
    towards = np.cos(about)[:, None] * frame.tangent + np.sin(about)[:, None] * frame.bitangent
    return np.cos(angle)[:, None] * normal + np.sin(angle)[:, None] * towards


THREE = ("RF", "RR", "LM")
FIVE = ("RF", "RR", "LR", "LM", "LF")
DISTRIBUTIONS = ("ground3", "wall3", "wall5")
OWN = ("ground", "wall")  # of any limbs of any robot, in its own stance
_ON_GROUND, _ON_WALLS = (0.1, 0.8), (0.1, 1.2)  # friction
_ON_MIDDLE = 1e-3  # [m] off the body's middle plane within which no wall is a toe's own


def select_distribution(
    name: str, robot: Robot, limbs: tuple[str, ...] | None = None
) -> TerrainDistribution:
    """Return terrains by name; limbs: those that stand, of `ground` and `wall` (None: all).

    Raises UsageError for another name, a robot without the limbs, and between walls for a toe in
    the middle of the body.
    """
    if name in OWN:
        return _build_own_distribution(name, robot, robot.limb_names if limbs is None else limbs)
    if name not in DISTRIBUTIONS:
        expected_names = ", ".join((*DISTRIBUTIONS, *OWN))
        raise UsageError(f"unknown terrains {name!r}: expected one of {expected_names}")
    legs = FIVE if name == "wall5" else THREE
    if lacking := [limb for limb in legs if limb not in robot.limb_names]:
        raise UsageError(f"{robot.name} has no limb {lacking[0]}, on which terrains {name!r} stand")
    if name == "ground3":
        up = np.tile([0.0, 0.0, 1.0], (len(legs), 1))
        return TerrainDistribution(name, select_ground_legs(robot, legs), up, _ON_GROUND)
    standing = select_wall_legs(robot, legs)
    side = -np.sign(standing.stance[:, :1]) * [1.0, 0.0, 0.0]
    return TerrainDistribution(name, standing, side, _ON_WALLS)


def _build_own_distribution(name: str, robot: Robot, limbs: tuple[str, ...]) -> TerrainDistribution:
    """Return limbs in the robot's own stance, on patches that face up or towards the body."""
    if lacking := [limb for limb in limbs if limb not in robot.limb_names]:
        limb_names = ", ".join(robot.limb_names)
        raise UsageError(f"{robot.name} has no limb {lacking[0]!r}, its limbs are {limb_names}")
    legs = select_standing_legs(robot, limbs)
    if name == "ground":
        up = np.tile([0.0, 0.0, 1.0], (legs.count, 1))
        return TerrainDistribution(name, legs, up, _ON_GROUND)
    across = legs.stance[:, 0]
    if (middle := np.abs(across) < _ON_MIDDLE).any():
        limb = limbs[int(np.argmax(middle))]
        raise UsageError(f"{limb} stands in the middle of {robot.name}, where no wall is its own")
    inward = -np.sign(across)[:, None] * [1.0, 0.0, 0.0]
    return TerrainDistribution(name, legs, inward, _ON_WALLS)
