"""Features by which learned methods compare scenes.

Published methods and values are those of X. Lin (UCLA 2022).
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from climbplan.arrays import Array
from climbplan.bookshelf.scene.rectangles import compute_half_extents
from climbplan.bookshelf.scene.shelf_scene import Shelf
from climbplan.bookshelf.statement.points import compute_features
from climbplan.schema.learning.strategy import ShelfFeatures

Features = Callable[[dict[str, Array]], Array]  # of the statement's parameters [mm, rad]
_ANGLE = 40.0  # [mm / rad] what a tilt weighs in distances: about half a book's height
_HEIGHT = 0.5  # heights decide less than widths


def build_feature_map(kind: ShelfFeatures, shelf: Shelf) -> Features:
    """Build the map from parameters to features, `raw` or `gaps`.

    `raw` is the published one with 5 n + 2 numbers. `gaps` has the free gaps and the sizes that may
    fill them, 4 n + 2 numbers.
    `gaps` are in millimetres, angles by half a book's height, and weigh as they are in distances:
    the gaps (n + 1) left of, between and right of the stored books, the inserted width, then
    angles, widths and heights of the stored books.
    """
    if kind == "raw":
        return compute_features
    left, right = 1e3 * shelf.left, 1e3 * shelf.right

    def gaps(theta: dict[str, Array]) -> Array:
        pose, size = theta["pose"], theta["size"]
        reach = compute_half_extents(pose[:, 2], size[:-1])[:, 0]
        begin = np.append(pose[:, 0] - reach, right)
        end = np.append(left, pose[:, 0] + reach)
        return np.concatenate(
            [
                begin - end,
                size[-1:, 1],
                _ANGLE * pose[:, 2],
                size[:-1, 1],
                _HEIGHT * size[:-1, 0],
            ]
        )

    return gaps


def compute_feature_scale(kind: ShelfFeatures, count: int) -> Array | None:
    """Return the scale (p,) of features in distances; None stands for their standard deviations."""
    return None if kind == "raw" else np.ones(count_features(kind, count))


def count_features(kind: ShelfFeatures, count: int) -> int:
    """Count the features of a scene with `count` stored books."""
    return 5 * count + 2 if kind == "raw" else 4 * count + 2
