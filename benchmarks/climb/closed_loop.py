"""`closed_loop`: worlds that differ from the plan, each climbed with and without the executive.

Drawn worlds have errors of mass, friction, surfaces, joint stiffness and backlash, whose standard
deviations are those of `DEVIATIONS`. A surprise is one error that the plan knows nothing of, the
rest as planned: a surface that toes stand on lies elsewhere or has less friction, the robot
carries more, a motor is weak, or a toe loses its friction for 0.2 s. Without the executive
the plan's regulator is at work alone. A robot that stops before its goal has to stand for five
seconds.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any, TextIO

import numpy as np

from benchmarks.kept_rows import read_rows, write_rows
from climbplan.climb.plan.climb_plan import ClimbPlan
from climbplan.climb.plan.promise import compute_interval
from climbplan.climb.planner.planner import plan_climb
from climbplan.climb.schema.loading import load_climb
from climbplan.climb.schema.transition_loading import load_transition
from climbplan.climb.simulation.replay import simulate
from climbplan.climb.simulation.worlds.uncertainty import (
    Distribution,
    Uncertainty,
    build_layout,
    draw_numbers,
    sample_conditions,
)
from climbplan.climb.transition.planner import plan_transition
from climbplan.errors import UsageError
from climbplan.simulation.conditions import Conditions, FrictionLoss, WeakMotor
from climbplan.simulation.world import World

SCENES = ("climb_patches", "climb_nonparallel", "climb_steps", "climb_obstacle")
# Others that can be named: all shipped scenes of toes on limbs of joints in a row
_OTHER_SCENES = (
    "climb_ground_to_wall", "climb_region", "climb_stairs", "climb_telescope", "climb_tube",
    "climb_tube_mesh", "climb_walker", "transition_flat",
)  # fmt: skip
_DRAWN_COUNT, _SURPRISE_COUNT = 20, 4
_SURPRISE_SALT = 0x73757270


def _normal(deviation: float) -> Distribution:
    return Distribution("normal", 0.0, deviation)


DEVIATIONS = Uncertainty(
    mass=_normal(0.05),
    friction=_normal(0.2),
    surface=_normal(3e-3),
    stiffness=_normal(0.1),
    backlash=_normal(float(np.deg2rad(0.2))),
)


def _shift(world: World, region: int, distance: float) -> World:
    surface = world.surface.copy()
    surface[region] = distance
    return replace(world, surface=surface)


def _scale_friction(world: World, region: int, factor: float) -> World:
    friction = world.friction.copy()
    friction[region] = factor
    return replace(world, friction=friction)


def _tilt(world: World, region: int, angle: float) -> World:
    tilt = world.tilt.copy()
    tilt[region, 0] = angle
    return replace(world, tilt=tilt)


_SURPRISES: dict[str, Callable[[World, int], World]] = {
    "20 mm nearer": lambda world, region: _shift(world, region, 0.02),
    "20 mm farther": lambda world, region: _shift(world, region, -0.02),
    "half the friction": lambda world, region: _scale_friction(world, region, 0.5),
    "tilted by 3 degrees": lambda world, region: _tilt(world, region, float(np.deg2rad(3.0))),
}
_PAYLOAD, _WEAK_MOTOR, _LOST_FRICTION = "2 kg more", "a motor at 60 %", "a toe without friction"
_SURPRISE_NAMES = (*_SURPRISES, _PAYLOAD, _WEAK_MOTOR, _LOST_FRICTION)
_MOTOR_SHARE = 0.6  # of its torque, of a weak motor
_LOSS_TIME = 0.2  # [s] without friction
DRAWN = "drawn"
_KINDS = (DRAWN, *_SURPRISE_NAMES)


@dataclass(frozen=True)
class ExecutionRow:
    """One world of a scene."""

    scene: str
    kind: str  # "drawn", or the surprise
    number: int
    is_closed: bool
    is_fallen: bool
    has_arrived: bool  # stands at the end of the plan
    clock: float  # [s] of the plan, at the end or where the robot left it
    duration: float  # [s] of the robot's
    stopped: str
    slips: int  # noticed by the executive
    replans: int  # plans from measured stances that it went on by
    step_median: float  # [s] computing time
    step_longest: float  # [s] likewise; force problems are solved in some steps


def bench_closed_loop(
    seed: int,
    quick: bool,
    out: TextIO,
    *,
    count: int | None = None,
    scenes: str | None = None,
    kinds: str | None = None,
    folder: Path | None = None,
) -> dict[str, Any]:
    """Print a line a scene and kind of world; two drawn worlds of one scene with `quick`.

    Args:
        seed: Of the worlds.
        quick: Whether to take two drawn worlds of the first scene.
        out: Takes the table, each line as soon as it is known.
        count: Of drawn worlds of each scene; None takes 20.
        scenes: Specs by commas; None takes `SCENES`.
        kinds: Of worlds by commas, `DRAWN` and surprises; None takes all. Others are listed where
            the folder holds all their worlds.
        folder: Keeps a row a world, which later runs do not simulate again.

    Raises:
        UsageError: Of `scenes` or `kinds` one is not known, or the folder holds something else.
    """
    names = _split_names("--scenes", scenes, SCENES, (*SCENES, *_OTHER_SCENES))
    requested_kinds = _split_names("--kinds", kinds, _KINDS, _KINDS)
    file = None if folder is None else folder / "closed_loop.csv"
    known = [] if file is None else read_rows(file, ExecutionRow)
    measured = {(row.scene, row.kind, row.number, row.is_closed): row for row in known}
    print(
        f"{'scene':<18}{'worlds':<22}{'open: fall':>14}{'closed: fall':>16}{'95 %':>14}"
        f"{'stop':>7}{'replan':>8}{'arrive':>9}{'time':>7}{'step':>9}",
        file=out,
        flush=True,
    )
    rows: list[ExecutionRow] = []
    for name in names[:1] if quick else names:
        plan: ClimbPlan | None = None  # once a world is to be simulated
        for kind in [DRAWN] if quick else _KINDS:
            number = _SURPRISE_COUNT if kind != DRAWN else count or _DRAWN_COUNT
            cells = [
                (name, kind, world, is_closed)
                for world in range(2 if quick else number)
                for is_closed in (False, True)
            ]
            if kind not in requested_kinds and not measured.keys() >= set(cells):
                continue
            for cell in cells:
                if cell not in measured:
                    plan = plan or _plan(Path("specs", f"{name}.yaml"))
                    measured[cell] = _execute(plan, *cell, seed=seed)
                    if file is not None:
                        write_rows(file, list(measured.values()))
            rows += [measured[cell] for cell in cells]
            _print_summary([measured[cell] for cell in cells], out)
    return {"rows": [asdict(row) for row in rows]}


def _split_names(
    option: str, names: str | None, default: tuple[str, ...], known: tuple[str, ...]
) -> tuple[str, ...]:
    """Split names at commas; raises UsageError for one that is not known."""
    split = default if names is None else tuple(name.strip() for name in names.split(","))
    if unknown := [name for name in split if name not in known]:
        raise UsageError(
            f"`closed_loop` {option}: {unknown[0]!r} is unknown, known are {', '.join(known)}"
        )
    return split


def _plan(spec: Path) -> ClimbPlan:
    if spec.stem.startswith("transition"):
        return plan_transition(load_transition(spec))
    return plan_climb(load_climb(spec))


def _execute(
    plan: ClimbPlan, scene: str, kind: str, number: int, is_closed: bool, *, seed: int
) -> ExecutionRow:
    run = simulate(plan, build_conditions(plan, kind, number, is_closed, seed))
    execution = run.execution
    stopped = "" if execution is None else execution.stopped
    has_arrived = not run.fallen and not stopped
    clock = float(plan.trajectory.time[-1] if has_arrived else run.time[-1])
    return ExecutionRow(
        scene=scene,
        kind=kind,
        number=number,
        is_closed=is_closed,
        is_fallen=run.fallen,
        has_arrived=has_arrived,
        clock=round(clock, 2),
        duration=round(clock if execution is None else execution.duration, 2),
        stopped=stopped,
        slips=0 if execution is None else sum(e.kind == "slipped" for e in execution.events),
        replans=0 if execution is None else len(execution.replans),
        step_median=0.0 if execution is None else float(np.median(execution.step_times)),
        step_longest=0.0 if execution is None else float(execution.step_times.max()),
    )


def build_conditions(
    plan: ClimbPlan, kind: str, number: int, is_closed: bool, seed: int
) -> Conditions:
    """Build the conditions of a world: a drawn one, or one with a surprise."""
    layout = build_layout(plan, DEVIATIONS)
    base = Conditions(closed_loop=is_closed, noise_seed=seed)
    if kind == DRAWN:
        return sample_conditions(base, layout, draw_numbers(seed, number, layout.size))
    if kind == _PAYLOAD:
        return replace(base, payload=2.0, noise_seed=number)
    draws = np.random.default_rng([_SURPRISE_SALT, seed, number])
    robot = plan.robot
    if kind == _WEAK_MOTOR:
        motor = WeakMotor(
            int(draws.integers(robot.limb_count)),
            int(draws.integers(robot.joint_count)),
            _MOTOR_SHARE,
        )
        return replace(base, weak_motors=(motor,), noise_seed=number)
    if kind == _LOST_FRICTION:
        start = float(draws.uniform(0.1, 0.9) * plan.trajectory.time[-1])
        loss = FrictionLoss(int(draws.integers(robot.limb_count)), start, _LOSS_TIME)
        return replace(base, losses=(loss,), noise_seed=number)
    region = int(draws.choice(np.unique(plan.rounds.region)))
    return replace(base, world=_SURPRISES[kind](layout.nominal, region), noise_seed=number)


def _print_summary(rows: list[ExecutionRow], out: TextIO) -> None:
    opened = [row for row in rows if not row.is_closed]
    closed = [row for row in rows if row.is_closed]
    falls = sum(row.is_fallen for row in closed)
    low, high = compute_interval(falls, len(closed))
    arrived = [row for row in closed if row.has_arrived]
    time = float(np.mean([row.duration / row.clock for row in arrived])) if arrived else np.nan
    step = 1e3 * float(np.median([row.step_median for row in closed]))
    print(
        f"{rows[0].scene:<18}{rows[0].kind:<22}"
        f"{f'{sum(row.is_fallen for row in opened)} of {len(opened)}':>14}"
        f"{f'{falls} of {len(closed)}':>16}{f'{low:.0%} to {high:.0%}':>14}"
        f"{sum(bool(row.stopped) for row in closed):>7}{sum(row.replans for row in closed):>8}"
        f"{f'{len(arrived)} of {len(closed)}':>9}{time:>7.2f}{f'{step:.2f} ms':>9}",
        file=out,
        flush=True,
    )
