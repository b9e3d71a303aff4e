"""A rough wall from a height map, as triangles, and a climb on them.

python examples/own_terrain.py
"""

from __future__ import annotations

import numpy as np

import climbplan
from climbplan.arrays import Array

LIMBS = {-1: ["LF", "LM", "LR"], 1: ["RF", "RM", "RR"]}


def rough_wall(side: int, rng: np.random.Generator) -> list[dict[str, object]]:
    """Two triangles a cell of a wall 1.4 m wide and 1.2 m high, rough by 10 mm."""
    y, z = np.meshgrid(np.linspace(-0.7, 0.7, 5), np.linspace(-0.6, 0.6, 5), indexing="ij")
    x = side * (0.615 + rng.uniform(-0.01, 0.01, y.shape))
    corners = np.stack([x, y, z], axis=-1)  # (5, 5, 3) [m]
    regions: list[dict[str, object]] = []
    for i, k in np.ndindex(4, 4):
        a, b, c, d = corners[i, k], corners[i + 1, k], corners[i + 1, k + 1], corners[i, k + 1]
        for triangle in ((a, b, c), (a, c, d)):
            # Anticlockwise as seen from between the walls
            seen: list[Array] = list(triangle if side < 0 else triangle[::-1])
            name = f"{'left' if side < 0 else 'right'} {len(regions)}"
            regions.append({"name": name, "vertices": np.array(seen), "limbs": LIMBS[side]})
    return regions


def main() -> None:
    rng = np.random.default_rng(1)
    scene = {
        "kind": "climb",
        "robot": "silvia",
        "terrain": {"friction": 1.0, "regions": rough_wall(-1, rng) + rough_wall(1, rng)},
        "task": {"rounds": 2, "start": {"com": [0, 0, 0]}, "goal": {"com": [0, 0, 0.15]}},
    }
    plan = climbplan.plan(scene)
    print(*plan.summary, sep="\n")
    print(plan.verify().headline())


if __name__ == "__main__":
    main()
