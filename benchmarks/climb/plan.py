"""Time of a whole decoupled plan by stages (`plan`)."""

from __future__ import annotations

import statistics
import time
from typing import TextIO

from climbplan.climb.motion.motion import StageClock, plan_motion, plan_support
from climbplan.climb.motion.trajectory import plan_trajectory
from climbplan.climb.scene.climb_scene import build_scene
from climbplan.climb.schema.loading import load_text
from climbplan.schema.examples import read_example

_PUBLISHED_TOTAL = 1.380  # [s] Gurobi, i7-8750H, posture and force stages (Table 5.1)


def bench_plan(seed: int, quick: bool, out: TextIO) -> None:
    """The whole decoupled plan of climb_obstacle: postures, kinematics, forces, trajectory."""
    loaded = load_text(
        read_example("climb_obstacle"), "climb_obstacle", [f"seed={seed}", "margins=none"]
    )
    repeats = 3 if quick else 9
    stages: dict[str, list[float]] = {}
    for _ in range(repeats):
        clock = StageClock(lambda stage, fraction: None)
        begin, spent = time.perf_counter(), time.process_time()
        with clock.stage("scene"):
            scene = build_scene(loaded.spec, loaded.robot, loaded.source)
        supported = plan_support(scene, plan_motion(scene, clock), clock)
        motion, forces = supported.motion, supported.forces
        planned = time.perf_counter() - begin
        busy = time.process_time() - spent
        with clock.stage("trajectory"):
            plan_trajectory(scene, motion.posture.rounds, motion.instants, forces, motion.swings)
        for stage, seconds in {**clock.seconds, "plan": planned, "busy": busy}.items():
            stages.setdefault(stage, []).append(seconds)
    rounds = loaded.spec.task.round_count
    print(f"climb_obstacle: {rounds} rounds, {motion.instants.count} force problems", file=out)
    print(f"{'stage':<28}{'median s':>10}{'of plan':>10}", file=out)
    whole = statistics.median(stages["plan"])
    for stage in ("scene", "posture", "kinematics", "force", "plan"):
        median = statistics.median(stages[stage])
        print(f"{stage:<28}{median:>10.4f}{median / whole:>9.0%}", file=out)
    after = statistics.median(stages["trajectory"])
    print(f"{'trajectory, beside the plan':<28}{after:>10.4f}", file=out)
    used = statistics.median(stages["busy"])
    print(f"{'plan, processor time':<28}{used:>10.4f}", file=out)
    print(
        f"plan = scene + posture + kinematics + force, checks included; published with Gurobi on "
        f"another machine: {_PUBLISHED_TOTAL:.2f} s for posture + force",
        file=out,
    )
