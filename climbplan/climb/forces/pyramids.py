"""Friction cones as inscribed pyramids, in two passes.

The pyramid of the first pass has equal sides. That of the second pass has most of its edges close
to the direction in which each contact shears, and starts from the rows that were active. Both lie
inside the cone, so that answers respect friction. The second pass comes as close to the optimum on
the cone as a regular pyramid of a hundred sides.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from climbplan.arrays import Array, BoolArray
from climbplan.climb.forces.reduction import (
    ReducedForces,
    ReducedHalfspaces,
    build_halfspaces,
    write_friction_rows,
)
from climbplan.mechanics.friction import regular_corners

_NUM_COARSE_CORNERS = 3  # corners that close the second pyramid on its far side
_FINE_WINDOW = 0.75  # half width of the fine part, in sides of the first pyramid


@dataclass(frozen=True)
class Optima:
    """Answers of a solver to B linear problems; not yet checked."""

    x: Array  # (B, q + 1) s and y
    active: BoolArray  # (B, m) rows with a multiplier
    solved: BoolArray  # (B,) what the solver says of itself


class RowSolver(Protocol):
    """Minimises a group's objective over halfspaces."""

    def __call__(
        self, group: ReducedForces, rows: ReducedHalfspaces, active: BoolArray | None = None
    ) -> Optima: ...


def solve_pyramids(group: ReducedForces, facets: int, solver: RowSolver) -> Optima:
    """Return optima over inscribed pyramids of `facets` sides; solved where both passes are."""
    b, n = group.limb.shape
    corners = np.broadcast_to(regular_corners(facets), (b, n, facets))
    rows = build_halfspaces(group, corners)
    first = solver(group, rows)
    write_friction_rows(
        group, rows, _place_corners(_compute_shear_direction(group, first.x[:, 1:]), facets)
    )
    second = solver(group, rows, _build_warm_start(first.active, rows))
    return Optima(second.x, second.active, first.solved & second.solved)


def _compute_shear_direction(group: ReducedForces, y: Array) -> Array:
    """Return the angle (B, n) of each tangential force from the tangent [rad]."""
    force = group.frame_particular + np.einsum("bniq,bq->bni", group.frame_null_space, y)
    return np.arctan2(force[..., 2], force[..., 1])


def _place_corners(direction: Array, facets: int) -> Array:
    """Return corners (B, n, F) around `direction` (B, n), one of them on it."""
    num_fine = max(1, facets - _NUM_COARSE_CORNERS)
    num_fine -= 1 - num_fine % 2  # odd, so that one corner is in the middle
    num_coarse = facets - num_fine
    width = _FINE_WINDOW * 2 * np.pi / facets if num_fine > 1 else 0.0
    fine_angles = np.linspace(-width, width, num_fine)
    coarse_angles = width + (2 * np.pi - 2 * width) * np.arange(1, num_coarse + 1) / (
        num_coarse + 1
    )
    return np.asarray(direction[..., None] + np.concatenate([fine_angles, coarse_angles]))


def _build_warm_start(active: BoolArray, rows: ReducedHalfspaces) -> BoolArray:
    """Return the initial active rows of the second pass.

    Active joints and contacts stay. Wherever friction was active, the facet that begins at the
    middle corner is.
    """
    n, facets = rows.num_contacts, rows.num_facets
    is_sliding = active[:, rows.friction].reshape(-1, n, facets).any(axis=-1)
    friction = np.zeros((len(active), n, facets), bool)
    num_fine = max(1, facets - _NUM_COARSE_CORNERS)
    friction[:, :, (num_fine - (1 - num_fine % 2)) // 2] = is_sliding
    initial_active = active.copy()
    initial_active[:, rows.friction] = friction.reshape(len(active), -1)
    return initial_active
