"""How a robot is set up before a run: toes on its surfaces as they are, the body where planned.

Surfaces of a world lie some millimetres off. Toes put where the plan believes surfaces to be would
start inside of some, from where MuJoCo throws them out by centimetres; nobody sets a robot up so.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from climbplan.arrays import Array
from climbplan.climb.plan.climb_plan import ClimbPlan
from climbplan.climb.simulation.model.toe import toe_radius
from climbplan.climb.simulation.worlds.ground import material
from climbplan.robots.kinematics import standing_inverse
from climbplan.terrain.model import Terrain

_DEEP = 1e-6  # [m] from which a toe counts as inside
_AHEAD = 0.1  # cosine from which a face is a way out
_TIMES = 3  # from one solid into the next


class Start(NamedTuple):
    """Toes and joints of a robot that is set up, N limbs of J joints."""

    toes: Array  # (N, 3) world [m]
    angles: Array  # (N, J) [rad]


def set_up(plan: ClimbPlan, terrain: Terrain) -> Start:
    """Toes of a plan's start put on the nearest places of their surfaces of a terrain.

    Where that is inside of other material (the next surface lies further out), they are put on that
    material. A limb that does not reach there keeps its planned toe.
    """
    com, rpy, planned = plan.rounds.com[0], plan.rounds.rpy[0], plan.rounds.toes[0]
    on = [terrain.surfaces[r] for r in plan.rounds.region[0]]
    put = np.array([s.project(toe) for s, toe in zip(on, planned, strict=True)])
    out = np.array([s.normal_at(toe) for s, toe in zip(on, put, strict=True)])
    if terrain.scan is None:
        put = _outside(put, out, material(terrain, toe_radius(plan.robot)))
    moved = standing_inverse(plan.robot, com, rpy, put, out)
    toes = np.where(moved.valid[:, None], put, planned)
    return Start(toes, standing_inverse(plan.robot, com, rpy, toes, out).best())


def _outside(places: Array, out: Array, solids: Array) -> Array:
    """Places (N, 3) moved along unit vectors (N, 3) out of solids (G, F, 4)."""
    ways = np.einsum("gfi,ni->gnf", solids[..., :3], out)
    for _ in range(_TIMES):
        room = solids[:, None, :, 3] - np.einsum("gfi,ni->gnf", solids[..., :3], places)
        inside = (room > _DEEP).all(axis=-1)  # (G, N)
        if not inside.any():
            break
        with np.errstate(divide="ignore", invalid="ignore"):
            length = np.where(ways > _AHEAD, room / ways, np.inf).min(axis=-1)
        far = np.where(inside & np.isfinite(length), length, 0.0).max(axis=0, initial=0.0)
        places = places + far[:, None] * out
    return places
