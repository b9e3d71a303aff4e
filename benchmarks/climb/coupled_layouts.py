"""Random layouts of slippery patches: which methods find plans with admissible forces."""

from __future__ import annotations

import time
from typing import TextIO

import numpy as np

from climbplan.climb.motion.motion import StageClock, plan_motion, plan_support
from climbplan.climb.scene.climb_scene import build_scene
from climbplan.climb.schema.model import ClimbSpec
from climbplan.errors import NoPlanFound
from climbplan.instances.patch_layout import generate_layout
from climbplan.schema.robots.source import load_robot

METHODS = ("micp", "coupled", "coupled-nlp", "coupled-mccormick")


def solves(spec: ClimbSpec) -> bool:
    """Whether a method finds postures and admissible forces at every instant."""
    scene = build_scene(spec, load_robot("silvia"))
    try:
        clock = StageClock(lambda stage, fraction: None)
        plan_support(scene, plan_motion(scene, clock), clock)
    except NoPlanFound:
        return False
    return True


def bench_layouts(seed: int, count: int, out: TextIO) -> None:
    """Print how many layouts each method solves, and its mean time."""
    print(f"\n{count} random layouts of slippery patches: plans with admissible forces", file=out)
    for method in METHODS:
        begin = time.perf_counter()
        found = sum(
            solves(generate_layout(np.random.default_rng([seed, k]), method)) for k in range(count)
        )
        mean = (time.perf_counter() - begin) / count
        print(f"{method:<14}{found:>4} of {count}   {mean:.2f} s each", file=out, flush=True)
