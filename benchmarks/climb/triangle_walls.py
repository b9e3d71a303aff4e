"""Two upright walls tiled by irregular triangles as contact regions, the same for the same seed."""

from __future__ import annotations

import numpy as np

from climbplan.climb.scene.climb_scene import ClimbScene, build_scene
from climbplan.climb.schema.model import ClimbSpec
from climbplan.schema.robots.source import load_robot

GOAL = (0.0, 0.1, 0.6)


def triangles(
    count: int,
    gap: float,
    rounds: int = 8,
    seed: int = 0,
    top: float = 1.4,
    goal: tuple[float, float, float] = GOAL,
) -> ClimbScene:
    """Two walls of irregular triangles, any toe on any of them, each shrunk by a share `gap`."""
    rng = np.random.default_rng(seed)
    across = max(d for d in range(1, int(np.sqrt(count / 4)) + 1) if (count // 4) % d == 0)
    regions: list[dict[str, object]] = []
    for side, x in (("left", -0.615), ("right", 0.615)):
        y, z = np.linspace(-0.9, 1.1, across + 1), np.linspace(-0.7, top, count // 4 // across + 1)
        grid = np.stack(np.meshgrid(y, z, indexing="ij"), -1)
        cell = np.array([y[1] - y[0], z[1] - z[0]])
        grid[1:-1, 1:-1] += rng.uniform(-0.3, 0.3, grid[1:-1, 1:-1].shape) * cell
        for i, j in np.ndindex(len(y) - 1, len(z) - 1):
            quad = [grid[i, j], grid[i + 1, j], grid[i + 1, j + 1], grid[i, j + 1]]
            for corners in ((0, 1, 2), (0, 2, 3)):
                flat = np.array([quad[c] for c in corners])
                flat = flat.mean(axis=0) + (1.0 - gap) * (flat - flat.mean(axis=0))
                vertices = [(x, float(a), float(b)) for a, b in flat]
                regions.append(
                    {
                        "name": f"{side} {len(regions)}",
                        "vertices": vertices if x < 0 else vertices[::-1],
                    }
                )
    assert len(regions) == count
    data = {
        "kind": "climb",
        "robot": "silvia",
        "terrain": {"friction": 1.0, "regions": regions},
        "task": {"rounds": rounds, "start": {"com": (0.0, 0.0, 0.0)}, "goal": {"com": goal}},
        "posture": {"weights": {"rotation": 0.01, "toe": 0.1}},
        "solver": {"method": "micp", "time_limit": 60.0, "gap": 0.01},
    }
    return build_scene(ClimbSpec.model_validate(data), load_robot("silvia"))
