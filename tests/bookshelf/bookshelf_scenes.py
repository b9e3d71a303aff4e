"""Scenes for tests: random ones that need movement, and a few published ones."""

from __future__ import annotations

import numpy as np

# Rows 2, 14, 22 and 48 of the published test set over all clusters (RoMeLaUCLA/CoCo, MIT licence):
# 3 x (x, y, angle, height, width), inserted height and width; mm, rad, to four decimals.
# fmt: off
PUBLISHED = np.array([
    [-47.5133, 14.9206, 1.5714, 67, 30, 17.7754, 29.5209, 1.0315, 75, 24,
     70.5532, 35.4453, 0.0012, 71, 21, 54, 20],
    [-43.0035, 9.9054, 1.5709, 76, 20, 9.9255, 27.0712, 0.9635, 65, 21,
     48.9516, 24.8349, 0.9621, 70, 12, 87, 18],
    [-55.1, 9.9019, 1.5708, 52, 20, -2.5605, 19.7895, 1.1433, 65, 14,
     50.3518, 26.2752, 1.1385, 52, 34, 64, 24],
    [-45.7643, 33.8835, 0.8121, 86, 12, -15.0004, 28.0658, 0.8134, 67, 14,
     49.5506, 5.4099, -1.5708, 63, 11, 63, 16],
])
# fmt: on

HALF_MM = {1: 37.11, 2: 59.11, 3: 81.11}  # shelf for that many stored books


def random_theta(rng: np.random.Generator, count: int, half_mm: float) -> np.ndarray:
    """A row with `count` books on the ground in order of their centres; they may overlap."""
    width = rng.integers(10, 41, count + 1).astype(float)
    height = rng.integers(50, 91, count + 1).astype(float)
    x = np.sort(rng.uniform(15 - half_mm, half_mm - 15, count))
    kind, side = rng.integers(0, 3, count), rng.choice([-1.0, 1.0], count)
    lean = rng.uniform(0.3, 1.3, count)
    angle = np.select([kind == 0, kind == 1], [np.zeros(count), np.full(count, np.pi / 2)], lean)
    angle = angle * side
    y = (width[:-1] * np.abs(np.sin(angle)) + height[:-1] * np.cos(angle)) / 2
    stored = np.stack([x, y, angle, height[:-1], width[:-1]], axis=1)
    return np.concatenate([stored.ravel(), [height[-1], width[-1]]])
