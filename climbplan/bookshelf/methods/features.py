"""What learned methods compare scenes by."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from climbplan.arrays import Array
from climbplan.bookshelf.scene.rectangles import half_extents
from climbplan.bookshelf.scene.shelf_scene import Shelf
from climbplan.bookshelf.statement.points import features_of
from climbplan.schema.learning.strategy import ShelfFeatures

Features = Callable[[dict[str, Array]], Array]  # of the statement's parameters [mm, rad]
_ANGLE = 40.0  # [mm / rad] what a tilt weighs in distances: about half a book's height
_HEIGHT = 0.5  # heights decide less than widths


def feature_map(kind: ShelfFeatures, shelf: Shelf) -> Features:
    """`raw`: as published, 5 n + 2 numbers; `gaps`: free gaps and what may fill them, 4 n + 2.

    `gaps` are in millimetres, angles by half a book's height, and weigh as they are in distances:
    the gaps (n + 1) left of, between and right of the stored books, the inserted width, then
    angles, widths and heights of the stored books.
    """
    if kind == "raw":
        return features_of
    left, right = 1e3 * shelf.left, 1e3 * shelf.right

    def gaps(theta: dict[str, Array]) -> Array:
        pose, size = theta["pose"], theta["size"]
        reach = half_extents(pose[:, 2], size[:-1])[:, 0]
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


def feature_scale(kind: ShelfFeatures, count: int) -> Array | None:
    """What features (p,) are divided by in distances; None: by their standard deviations."""
    return None if kind == "raw" else np.ones(feature_count(kind, count))


def feature_count(kind: ShelfFeatures, count: int) -> int:
    """How many features a scene with `count` stored books has."""
    return 5 * count + 2 if kind == "raw" else 4 * count + 2
