"""The coupled planner against CVXPY, and against other methods on random slippery patches."""

from __future__ import annotations

import statistics
import time
from collections.abc import Callable
from dataclasses import dataclass
from importlib.util import find_spec
from typing import TextIO, TypeVar

import numpy as np

from climbplan.climb.benchmarks.coupled_cvxpy import cvxpy_stages
from climbplan.climb.coupled.envelopes import braced_envelope
from climbplan.climb.coupled.planner import first_stage, second_stage
from climbplan.climb.coupled.statement import coupled_program, envelope_range, loadable
from climbplan.climb.planner import StageClock, plan_motion, plan_support
from climbplan.climb.postures.statement import PostureMargins, posture_program
from climbplan.climb.scene import ClimbScene, build_scene
from climbplan.coupled.legs import POSITION_SCALE
from climbplan.errors import Infeasible, LimitReached, ReachFailure
from climbplan.learning.envelope_box import Envelope
from climbplan.program import Program
from climbplan.program.instance import Instance
from climbplan.program.polytope import Array
from climbplan.reformulations.pinned import PinnedForm
from climbplan.solvers.ipopt import solve_ipopt
from climbplan.solvers.registry import solve
from climbplan.spec.climb import ClimbSpec
from climbplan.spec.examples import example_text
from climbplan.spec.loading import load_text
from climbplan.spec.robot_source import load_robot

Answer = TypeVar("Answer")

PUBLISHED = "published 160 ms: Gurobi through its interface, i5-6260U (Table 5.3)"
METHODS = ("micp", "coupled", "coupled-nlp")
_GOAL_TOES, _KEEP = (0.15, 0.23), 0.01  # heights at the goal, and room about them [m]
_HALF_GAP, _ALONG, _LOW, _HIGH = 0.615, 1.8, -0.65, 1.0  # [m]


@dataclass(frozen=True)
class Stages:
    """A scene whose regions are chosen: what the two stages start from."""

    scene: ClimbScene
    program: Program
    pinned: Instance
    envelope: Envelope
    bound: float  # of postures alone


def prepared_stages(rounds: int, seed: int) -> Stages:
    """climb_patches over more rounds, payload by seed."""
    mass = float(np.random.default_rng(seed).uniform(0.0, 1.5))
    given = [f"task.rounds={rounds}", f"task.payload.mass={mass:.3f}"]
    loaded = load_text(example_text("climb_patches"), "climb_patches", given)
    scene = build_scene(loaded.spec, loaded.robot, loaded.source)
    envelope = braced_envelope(scene)
    scene = loadable(scene, envelope)
    alone = posture_program(scene, PostureMargins()).at()
    first = solve(alone, "branch-and-bound")
    if first.x is None or first.assignment is None:
        raise LimitReached("no postures for the bench instance")
    program = coupled_program(scene, PostureMargins(), envelope)
    instance = program.at()
    guess = np.clip(np.zeros(instance.size), instance.lower, instance.upper)
    guess[: alone.size] = first.x
    pinned = PinnedForm.of(instance).at(guess, first.assignment, compact=True)
    return Stages(scene, program, pinned, envelope, first.bound)


def bench_coupled(seed: int, quick: bool, out: TextIO) -> None:
    """Print the two stages against CVXPY and IPOPT, then success on random patch layouts."""
    stages = prepared_stages(8, seed)
    repeats = 3 if quick else 9
    x: Array | None = None

    def both() -> Array:
        nonlocal x
        x = first_stage(stages.scene, stages.program, stages.pinned, stages.envelope)
        answer = None if x is None else second_stage(stages.program, stages.pinned, x)
        if answer is None:
            raise LimitReached("the bench instance has no answer by two stages")
        return answer

    ours, answer = _timed(both, repeats)
    cost = stages.pinned.objective(answer)
    gap = max(0.0, cost - stages.bound) / max(abs(cost), 1e-9)
    print(f"coupled planner, 8 rounds, CPU time of one thread; {PUBLISHED}", file=out)
    print(f"{'':<42}{'ms':>9}{'ratio':>8}{'cost':>12}", file=out)
    _row(out, "P1 (Clarabel) and P2 (HiGHS)", ours, ours, cost)
    if find_spec("cvxpy") is not None:
        within = envelope_range(
            stages.scene, stages.program, stages.pinned, stages.envelope, POSITION_SCALE
        )
        theirs, value = _timed(
            lambda: cvxpy_stages(stages.pinned, within, stages.program.variables["force"]), 1
        )
        _row(out, "the same two stages through CVXPY", theirs, ours, value)
    else:
        print("left out: CVXPY is not installed", file=out)
    start = x if x is not None else answer
    whole, local = _timed(lambda: solve_ipopt(stages.pinned, start=start), 1)
    if local.objective is not None:
        _row(out, "IPOPT on everything, from P1", whole, ours, local.objective)
    print(f"gap of the two stages to postures without forces: {gap:.1e}", file=out)
    _layouts(seed, 4 if quick else 50, out)


def _row(out: TextIO, name: str, ms: float, ours: float, cost: float) -> None:
    print(f"{name:<42}{ms:>9.1f}{ms / ours:>8.1f}{cost:>12.6f}", file=out)


def _timed(run: Callable[[], Answer], repeats: int) -> tuple[float, Answer]:
    """Median CPU time [ms], which other processes do not lengthen, and the last answer."""
    times = []
    for _ in range(repeats):
        begin = time.process_time()
        answer = run()
        times.append(time.process_time() - begin)
    return 1e3 * statistics.median(times), answer


def _band(rng: np.random.Generator) -> tuple[float, float]:
    """Middle and half height of a band that holds no toe at the goal [m]."""
    while True:
        middle, half = float(rng.uniform(0.0, 0.34)), float(rng.uniform(0.02, 0.07))
        if all(abs(z - middle) > half + _KEEP for z in _GOAL_TOES):
            return middle, half


def random_layout(rng: np.random.Generator, method: str) -> ClimbSpec:
    """Both walls with a slippery band of random height and width, climbed in four rounds."""
    regions = []
    for side, sign in (("left", -1.0), ("right", 1.0)):
        middle, half = _band(rng)
        limbs = [f"{side[0].upper()}{row}" for row in "FMR"]
        for name, low, high, friction in (
            ("lower", _LOW, middle - half, None),
            ("patch", middle - half, middle + half, 0.001),
            ("upper", middle + half, _HIGH, None),
        ):
            regions.append(
                {
                    "name": f"{side} {name}",
                    "rectangle": {
                        "center": (sign * _HALF_GAP, 0.0, (low + high) / 2),
                        "normal": (-sign, 0.0, 0.0),
                        "width": _ALONG,
                        "height": high - low,
                    },
                    "limbs": limbs,
                    "friction": friction,
                }
            )
    return ClimbSpec.model_validate(
        {
            "kind": "climb",
            "robot": "silvia",
            "terrain": {"friction": 1.0, "regions": regions},
            "task": {
                "rounds": 4,
                "start": {"com": (0.0, 0.0, 0.0)},
                "goal": {"com": (0.0, 0.0, 0.35)},
            },
            "solver": {"method": method, "time_limit": 20.0},
        }
    )


def solves(spec: ClimbSpec) -> bool:
    """Whether a method finds postures and admissible forces at every instant."""
    scene = build_scene(spec, load_robot("silvia"))
    try:
        clock = StageClock(lambda stage, fraction: None)
        plan_support(scene, plan_motion(scene, clock), clock)
    except (Infeasible, ReachFailure, LimitReached):
        return False
    return True


def _layouts(seed: int, count: int, out: TextIO) -> None:
    print(f"\n{count} random layouts of slippery bands: plans with admissible forces", file=out)
    for method in METHODS:
        found = sum(
            solves(random_layout(np.random.default_rng([seed, k]), method)) for k in range(count)
        )
        print(f"{method:<14}{found:>4} of {count}", file=out)
