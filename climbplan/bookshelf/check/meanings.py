"""Select the exact check by its meaning, and refute claims that no placement exists."""

from __future__ import annotations

import numpy as np

from climbplan.arrays import Array, BoolArray, IntArray
from climbplan.bookshelf.check.checker import LENGTH_LIMIT, check_contact
from climbplan.bookshelf.check.checks import PlacementCheck
from climbplan.bookshelf.check.published import check_published
from climbplan.bookshelf.scene.shelf_scene import Scenes, Shelf


def check_placements(
    scenes: Scenes, pose: Array, state: IntArray, shelf: Shelf, meaning: str
) -> PlacementCheck:
    """Check placements of S scenes: pose (S, n + 1, 3) [m, rad], state (S, n + 1)."""
    check = check_contact if meaning == "contact" else check_published
    return check(scenes, pose, state, shelf)


def fit_side_by_side(scenes: Scenes, shelf: Shelf) -> BoolArray:
    """Return a mask (S,) of the scenes whose books all fit side by side, upright or flat.

    These scenes have a placement in the meaning `contact`. Books that fit with less than 0.01 mm
    to spare are left out.
    """
    height, width = scenes.sizes[..., 0], scenes.sizes[..., 1]
    upright = np.where(height <= shelf.height, width, np.inf)
    flat = np.where(width <= shelf.height, height, np.inf)
    fits: BoolArray = np.minimum(upright, flat).sum(axis=1) < shelf.width - LENGTH_LIMIT
    return fits
