"""Place a robot at the start of a simulation: toes on the actual surfaces, the body where planned.

The surfaces of a world lie some millimetres off. Toes at their planned places would start inside
some of them, and contact forces would throw them out.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from climbplan.arrays import Array
from climbplan.climb.plan.climb_plan import ClimbPlan
from climbplan.climb.simulation.model.toe import compute_toe_radius
from climbplan.climb.simulation.worlds.perturbed_terrain import build_collision_solids
from climbplan.robots.kinematics import standing_inverse
from climbplan.terrain.model import Terrain

_DEPTH_TOLERANCE = 1e-6  # [m] below the surface, from which a toe is inside
_MIN_DIRECTION_COSINE = 0.1  # between direction and normal of a face, to leave through it
_MAX_PASSES = 3  # as a toe may move from one solid into the next


class InitialPosture(NamedTuple):
    """Toes and joints of a robot at its start, N limbs of J joints."""

    toes: Array  # (N, 3) world [m]
    angles: Array  # (N, J) [rad]


def place_robot(plan: ClimbPlan, terrain: Terrain) -> InitialPosture:
    """Place the toes of a plan's start on the nearest points of their surfaces of a terrain.

    Toes inside another solid are moved to its surface. A limb that does not reach there keeps its
    planned toe.
    """
    com, rpy, planned = plan.rounds.com[0], plan.rounds.rpy[0], plan.rounds.toes[0]
    surfaces = [terrain.surfaces[r] for r in plan.rounds.region[0]]
    projected = np.array([s.project(toe) for s, toe in zip(surfaces, planned, strict=True)])
    normals = np.array([s.normal_at(toe) for s, toe in zip(surfaces, projected, strict=True)])
    if terrain.scan is None:
        projected = _push_outside(
            projected, normals, build_collision_solids(terrain, compute_toe_radius(plan.robot))
        )
    solution = standing_inverse(plan.robot, com, rpy, projected, normals)
    toes = np.where(solution.valid[:, None], projected, planned)
    return InitialPosture(toes, standing_inverse(plan.robot, com, rpy, toes, normals).best())


def _push_outside(places: Array, directions: Array, solids: Array) -> Array:
    """Push positions (N, 3) along unit vectors (N, 3) out of solids (G, F, 4)."""
    approach_rate = np.einsum("gfi,ni->gnf", solids[..., :3], directions)
    for _ in range(_MAX_PASSES):
        slack = solids[:, None, :, 3] - np.einsum("gfi,ni->gnf", solids[..., :3], places)
        inside = (slack > _DEPTH_TOLERANCE).all(axis=-1)  # (G, N)
        if not inside.any():
            break
        with np.errstate(divide="ignore", invalid="ignore"):
            length = np.where(
                approach_rate > _MIN_DIRECTION_COSINE, slack / approach_rate, np.inf
            ).min(axis=-1)
        distance = np.where(inside & np.isfinite(length), length, 0.0).max(axis=0, initial=0.0)
        places = places + distance[:, None] * directions
    return places
