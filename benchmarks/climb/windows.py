"""`windows`: long climbs in windows of rounds, by window, against one search, and to an end.

Walls of a thousand triangles are planned in 30 rounds: in windows of 2, 4 and 8 rounds and all at
once, where that ends in its time, by branch and bound and by the L1 relaxation. A rocky tube of a
thousand panels is climbed from a scan to its end, and verified.
"""

from __future__ import annotations

import tempfile
import time
from dataclasses import replace
from pathlib import Path
from typing import TextIO

from benchmarks.climb.rocky_tubes import rocky_tube
from benchmarks.climb.triangle_walls import triangles
from climbplan.climb.check.verification import verify_plan
from climbplan.climb.motion.motion import StageClock, plan_motion
from climbplan.climb.planner.planner import plan_climb
from climbplan.climb.postures.planner import PostureResult
from climbplan.climb.scene.climb_scene import ClimbScene
from climbplan.climb.schema.loading import load_climb
from climbplan.climb.windows.windows import plan_in_windows
from climbplan.errors import NoPlanFound

_WINDOWS = (2, 4, 8)
_LIMIT = 300.0  # [s] of a way, whole or in windows
TUBE = """\
kind: climb
robot: silvia
terrain:
  friction: 1.0
  scan: {{file: tube.stl}}
task:
  rounds: auto
  start: {{com: [0, 0, 0.4]}}
  goal: {{com: [0, 0, {goal}]}}
  stance: {{RF: [0.3075, 0.5326, -0.12], RM: [0.615, 0, -0.12], RR: [0.3075, -0.5326, -0.12],
    LR: [-0.3075, -0.5326, -0.12], LM: [-0.615, 0, -0.12], LF: [-0.3075, 0.5326, -0.12]}}
solver: {{method: micp, time_limit: 1800, window: 2}}
posture: {{steps: {{com_max: 0.08}}}}
trajectory: {{swing_clearance: 0.03}}
"""
"""A climb up the tube, all in it but `goal`, the height [m] of the body at its end."""


def bench_windows(seed: int, quick: bool, out: TextIO) -> None:
    """Walls of 1,000 triangles in 30 rounds, and a tube of 1,000 panels and 5 m; with `quick` 200
    triangles in 10 rounds, and the tube's first 30 cm.
    """
    _walls(seed, quick, out)
    print(file=out)
    _tube(seed, quick, out)


def _walls(seed: int, quick: bool, out: TextIO) -> None:
    count, rounds, top, goal = (200, 10, 2.0, 1.2) if quick else (1000, 30, 4.8, 3.9)
    scene = triangles(count, 0.1, rounds, seed, top=top, goal=(0.0, 0.0, goal))
    print(f"{count} triangles, {rounds} rounds", file=out)
    columns = f"{'cost':>10}{'bound':>10}{'over it':>9}{'nodes':>8}{'CPU s':>8}{'s':>8}"
    print(f"{'method':<16}{'window':>8}{columns}", file=out)
    for window in _WINDOWS:
        _row(_by(scene, "micp"), window, out)
    _row(_by(scene, "micp"), None, out)
    _row(_by(scene, "sl1-relaxation"), None, out)
    print(
        "bounds of windows are those of straight ways in as many rounds, one search has its own",
        file=out,
    )


def _by(scene: ClimbScene, method: str) -> ClimbScene:
    solver = scene.spec.solver.model_copy(update={"method": method, "time_limit": _LIMIT})
    return replace(scene, spec=scene.spec.model_copy(update={"solver": solver}))


def _row(scene: ClimbScene, window: int | None, out: TextIO) -> None:
    begin, spent = time.perf_counter(), time.process_time()
    label = f"{scene.spec.solver.method:<16}{window or 'all':>8}"
    try:
        found = _postures(scene, window)
    except NoPlanFound as error:
        told = str(error).partition("\n")[0]
        took = f"{time.process_time() - spent:.1f} CPU s"
        print(f"{label}  no plan in {took}: {told}", file=out, flush=True)
        return
    busy, whole = time.process_time() - spent, time.perf_counter() - begin
    bound = "-" if found.bound is None else f"{found.bound:.5f}"
    over = "-" if not found.bound else f"{found.objective / found.bound - 1:.2%}"
    line = f"{label}{found.objective:>10.5f}{bound:>10}{over:>9}{found.nodes:>8}"
    print(f"{line}{busy:>8.1f}{whole:>8.1f}", file=out, flush=True)


def _postures(scene: ClimbScene, window: int | None) -> PostureResult:
    """Postures that pass the exact kinematic and force checks of their stage."""
    clock = StageClock(lambda stage, fraction: None)
    deadline = time.monotonic() + _LIMIT
    if window is None:
        return plan_motion(scene, clock, deadline=deadline).posture
    return plan_in_windows(scene, window, clock, deadline).supported.motion.posture


def _tube(seed: int, quick: bool, out: TextIO) -> None:
    goal = 0.7 if quick else 4.6
    with tempfile.TemporaryDirectory() as folder:
        tube = rocky_tube(seed=seed)
        tube.export(Path(folder, "tube.stl"))
        spec = Path(folder, "tube.yaml")
        spec.write_text(TUBE.format(goal=goal))
        print(f"a rocky tube of {len(tube.faces)} panels, from 0.4 to {goal} m", file=out)
        spent = time.process_time()
        try:
            plan = plan_climb(load_climb(spec))
        except NoPlanFound as error:
            told = str(error).partition("\n")[0]
            print(f"no plan in {time.process_time() - spent:.1f} CPU s: {told}", file=out)
            return
    planned = time.process_time() - spent
    verification = verify_plan(plan)
    judged = time.process_time() - spent - planned
    sizes = plan.sizes["posture"]
    print(f"regions {len(plan.terrain.regions)}, rounds {plan.rounds.count}, ", file=out, end="")
    print(f"windows {sizes['windows']}, nodes {sizes['nodes']}", file=out)
    print(f"cost {plan.objective:.5f}, bound of the straight way {plan.bound:.5f}", file=out)
    print(f"verify: {verification.headline()}", file=out)
    print(f"planned in {planned:.1f} CPU s, verified in {judged:.1f}", file=out)
