"""Comparison of ways to solve the posture program (`posture` and `growth`)."""

from __future__ import annotations

import copy
import statistics
import time
from typing import Any, TextIO

import numpy as np

from climbplan.climb.motion.motion import StageClock, plan_motion
from climbplan.climb.postures.statement import build_posture_program
from climbplan.climb.scene.climb_scene import ClimbScene, build_scene
from climbplan.climb.schema.model import ClimbSpec
from climbplan.program import Instance
from climbplan.reformulations.disjunctions import BigM
from climbplan.schema.robots.robot import RobotSpec
from climbplan.schema.robots.source import load_robot
from climbplan.solvers.registry import solve
from climbplan.solvers.result import SolverResult

PUBLISHED = "Gurobi, published for an i7-8750H, set-up included (Table 5.1): 0.420 s"

_GAP = 1e-4  # proven by ours
_SCIP_GAP = 1e-2
_SCIP_LIMIT = 60.0  # [s]
_WALL = 0.615  # [m] from the middle to each wall
# Three rectangles a wall, below, in front of and above an obstacle: y and z from, to [m]
_RECTANGLES = {
    "lower": (-0.9, 1.1, -0.7, 0.22),
    "middle": (0.02, 1.1, 0.22, 0.58),
    "upper": (-0.9, 1.1, 0.58, 1.4),
}


def published_scene(seed: int, free_sides: bool = False) -> ClimbScene:
    """The published setting with a random goal: 8 rounds, 6 toes, 3 regions a toe (144 binaries).

    Without what goes beyond the published program: 104 balls beside the goal's, no body clearance.
    free_sides: any toe may stand on either wall (288 binaries).
    """
    rng = np.random.default_rng(seed)
    regions = []
    for side, x in (("left", -_WALL), ("right", _WALL)):
        for name, (y0, y1, z0, z1) in _RECTANGLES.items():
            corners = [(x, y0, z0), (x, y1, z0), (x, y1, z1), (x, y0, z1)]
            region: dict[str, Any] = {
                "name": f"{side} {name}",
                "vertices": corners if x < 0 else corners[::-1],
            }
            if not free_sides:
                region["limbs"] = [f"{side[0].upper()}{row}" for row in "FMR"]
            regions.append(region)
    data = {
        "kind": "climb",
        "margins": "none",  # as published
        "robot": "silvia",
        "terrain": {"friction": 1.0, "regions": regions},
        "task": {
            "rounds": 8,
            "start": {"com": (0.0, 0.0, 0.0)},
            "goal": {"com": (0.0, rng.uniform(0.2, 0.4), rng.uniform(0.7, 0.85))},
        },
        "posture": {"stance_workspace": False, "check_reach_during_round": False},
    }
    return build_scene(ClimbSpec.model_validate(data), load_robot("silvia"))


def _timed(instance: Instance, solver: str, gap: float, limit: float) -> tuple[SolverResult, float]:
    """Result and processor time [s] of one thread, which other processes hardly lengthen."""
    begin = time.process_time()
    result = solve(instance, solver, gap=gap, time_limit=limit)
    return result, time.process_time() - begin


def _time_scip(instance: Instance) -> tuple[SolverResult, float, str]:
    """Return the better of SCIP's answers on hulls and on big-M rows, its time [s] and its form."""
    trials = [
        (*_timed(written, solver, _SCIP_GAP, _SCIP_LIMIT), form)
        for written, solver, form in (
            (instance, "scip", "hulls"),
            (BigM().apply(instance).instance, "minlp-scip", "big-M"),
        )
    ]
    return min(trials, key=lambda trial: (trial[0].status != "optimal", trial[1]))


def bench_posture(seed: int, quick: bool, out: TextIO) -> None:
    """Own branch and bound to 1e-4 against SCIP to 1 %, on the same instances in turn."""
    ratios = []
    head = (
        f"{'instance':<26}{'ours s':>9}{'nodes':>7}{'gap':>9}{'SCIP s':>9}{'gap':>9}{'form':>7}"
        f"{'ratio':>8}"
    )
    print(head, file=out)
    cases = [(f"goal {k}, 144 binaries", seed + k, False) for k in range(2 if quick else 6)]
    cases += [(f"goal {k}, 288 binaries", seed + k, True) for k in range(0 if quick else 2)]
    for label, case_seed, free_sides in cases:
        instance = build_posture_program(published_scene(case_seed, free_sides)).instantiate()
        ours, seconds = _timed(instance, "branch-and-bound", _GAP, _SCIP_LIMIT)
        other, other_seconds, form = _time_scip(instance)
        ratio = other_seconds / seconds
        ratios.append(ratio)
        at_least = ">" if other.status != "optimal" else " "
        print(
            f"{label:<26}{seconds:>9.3f}{ours.nodes:>7}{_shown(ours.gap):>9}"
            f"{other_seconds:>9.2f}{_shown(other.gap):>9}{form:>7}{at_least:>2}{ratio:>6.0f}",
            file=out,
            flush=True,
        )
    print(
        f"processor time; ours proves {_GAP:g}, SCIP {_SCIP_GAP:g} or {_SCIP_LIMIT:.0f} s of the "
        "clock; ratio SCIP / ours: "
        f"least {min(ratios):.0f}, median {statistics.median(ratios):.0f}",
        file=out,
    )
    print(f"for context: {PUBLISHED}", file=out)


def _shown(gap: float | None) -> str:
    return "none" if gap is None else f"{gap:.1e}"


def braced_robot(limbs: int) -> RobotSpec:
    """SiLVIA's middle legs on a body long enough for any number of limbs on two sides."""
    silvia = load_robot("silvia")
    pattern = next(limb for limb in silvia.limbs if limb.name == "RM").model_dump()
    right = (limbs + 1) // 2
    rows = []
    for index in range(limbs):
        side, row, count = (
            (1, index, right) if index < right else (-1, index - right, limbs - right)
        )
        y = 0.22 * (row - (count - 1) / 2)
        limb = copy.deepcopy(pattern)
        limb.update(
            name=f"{'R' if side > 0 else 'L'}{row + 1}",
            side="right" if side > 0 else "left",
            shoulder=(side * 0.224, y, 0.0),
            mount_yaw_deg=0.0 if side > 0 else 180.0,
            stance=(side * _WALL, y, -0.2),
        )
        rows.append(limb)
    data = silvia.model_dump()
    half = 0.11 * right + 0.1
    data.update(limbs=rows, name=f"{limbs} limbs", body_half_size=(0.13, half, 0.05))
    return RobotSpec.model_validate(data)


def _growth_scene(rounds: int, limbs: int) -> ClimbScene:
    """Straight up between two walls of three rectangles each, 100 mm a round."""
    height = 0.1 * rounds
    levels = [(-1.0, 0.3 * height), (0.3 * height, 0.6 * height), (0.6 * height, height + 1.0)]
    robot = braced_robot(limbs)
    regions = []
    for side, x in (("left", -_WALL), ("right", _WALL)):
        for k, (z0, z1) in enumerate(levels):
            corners = [(x, -1.2, z0), (x, 1.2, z0), (x, 1.2, z1), (x, -1.2, z1)]
            regions.append(
                {
                    "name": f"{side} {k}",
                    "vertices": corners if x < 0 else corners[::-1],
                    "limbs": [limb.name for limb in robot.limbs if limb.side == side],
                }
            )
    data = {
        "kind": "climb",
        "margins": "none",  # as published
        "robot": "made here",
        "terrain": {"friction": 1.0, "regions": regions},
        "task": {
            "rounds": rounds,
            "start": {"com": (0.0, 0.0, 0.0)},
            "goal": {"com": (0.0, 0.0, height)},
        },
    }
    return build_scene(ClimbSpec.model_validate(data), robot)


def bench_growth(seed: int, quick: bool, out: TextIO) -> None:
    """Cost of posture and kinematics as rounds and limbs grow, relative to 8 rounds of 6 limbs.

    Processor time of the second call of each size: the first one compiles, or reads what is.
    """
    rounds = (2, 4, 8) if quick else (2, 4, 8, 16, 32)
    limbs = (4, 6) if quick else (4, 5, 6, 7, 8)
    head = f"{'rounds':>7}{'limbs':>7}{'variables':>11}{'binaries':>10}{'CPU s':>9}{'nodes':>7}"
    print(head + f"{'gap':>9}{'ratio':>8}", file=out)
    base = _growth_row(8, 6)
    for m, n in [*((m, 6) for m in rounds), *((8, n) for n in limbs if n != 6)]:
        row = base if (m, n) == (8, 6) else _growth_row(m, n)
        print(
            f"{m:>7}{n:>7}{row['variables']:>11}{row['binaries']:>10}{row['seconds']:>9.3f}"
            f"{row['nodes']:>7}{_shown(row['gap']):>9}{row['seconds'] / base['seconds']:>8.2f}",
            file=out,
            flush=True,
        )


def _growth_row(rounds: int, limbs: int) -> dict[str, Any]:
    scene = _growth_scene(rounds, limbs)
    plan_motion(scene, StageClock(lambda stage, fraction: None))
    begin = time.process_time()
    motion = plan_motion(scene, StageClock(lambda stage, fraction: None))
    sizes = motion.posture.sizes
    return {
        "seconds": time.process_time() - begin,
        "variables": sizes["continuous"],
        "binaries": sizes["binary"],
        "nodes": motion.posture.nodes,
        "gap": motion.posture.gap,
    }
