"""A round upright tube of rock: panels at angles of their own, the same for the same seed."""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np
import trimesh

RADIUS = 0.615  # [m]


def rocky_tube(
    height: float = 5.0, around: int = 20, rows: int = 25, rough: float = 0.012, seed: int = 0
) -> trimesh.Trimesh:
    """A tube of 2 x around x rows triangular panels about the z axis, from z = 0 up.

    height: [m]. rough: standard deviation of its corners' radius [m].
    """
    rng = np.random.default_rng(seed)
    angle = 2 * np.pi * (np.arange(around) / around)
    level = np.linspace(0, height, rows + 1)
    radius = RADIUS + np.clip(rng.normal(0, rough, (rows + 1, around)), -2 * rough, 2 * rough)
    corners = np.stack(
        [
            radius * np.cos(angle),
            radius * np.sin(angle),
            np.broadcast_to(level[:, None], radius.shape),
        ],
        axis=-1,
    ).reshape(-1, 3)
    row, turn = (n.ravel() for n in np.meshgrid(np.arange(rows), np.arange(around), indexing="ij"))
    low, beside = row * around + turn, row * around + (turn + 1) % around
    up, across = low + around, beside + around
    # Seen from the axis anticlockwise
    faces = np.concatenate(
        [np.stack([low, across, beside], axis=1), np.stack([low, up, across], axis=1)]
    )
    return trimesh.Trimesh(corners, faces, process=False)


def main() -> None:
    """Write one as an STL file."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("file", type=Path)
    parser.add_argument("--height", type=float, default=5.0)
    parser.add_argument("--seed", type=int, default=0)
    given = parser.parse_args()
    rocky_tube(height=given.height, seed=given.seed).export(given.file)


if __name__ == "__main__":
    main()
