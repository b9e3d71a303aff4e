"""A climb or transition simulated: the nominal run, and random worlds."""

from __future__ import annotations

import logging
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import numpy as np

from climbplan.climb.plan.climb_plan import ClimbPlan
from climbplan.climb.simulation.comparison import Comparison, compare
from climbplan.climb.simulation.model.link_masses import link_masses
from climbplan.climb.simulation.replay import Run, simulate
from climbplan.climb.simulation.risk.judging import Judged, judge_plan, world_conditions
from climbplan.climb.simulation.risk.rare import Rare, rare_falls
from climbplan.climb.simulation.sweep import Sweep, SweepPoint, sweep
from climbplan.climb.simulation.variations import climb_trial, drawn_conditions
from climbplan.simulation.asked import Asked
from climbplan.simulation.conditions import LIMB_MASS_SHARE, Conditions, require_possible
from climbplan.simulation.mujoco_loading import load_mujoco
from climbplan.simulation.pictures import Camera, open_camera
from climbplan.simulation.trials import Trial, run_trials

_log = logging.getLogger(__name__)


@dataclass(frozen=True)
class WorstWorld:
    """The world in which a plan fares worst, replayed in MuJoCo."""

    number: int
    run: Run
    film: bytes  # animated GIF

    @property
    def words(self) -> str:
        """What becomes of the robot there."""
        return f"falls at {self.run.time[-1]:.1f} s" if self.run.fallen else "stands"


@dataclass(frozen=True)
class Simulated:
    """Everything one call of the command found."""

    plan: ClimbPlan
    run: Run
    compared: Comparison
    trials: tuple[Trial, ...]
    sweep_key: str
    points: tuple[SweepPoint, ...]
    camera: Camera | str  # with its pictures, or why there are none
    judged: Judged | None = None  # in worlds of the plan's uncertainty
    rare: Rare | None = None  # likewise, where falls are too few to count
    worst: WorstWorld | None = None  # of those judged, where there are pictures


def simulate_plan(
    plan: ClimbPlan,
    asked: Asked,
    progress: Callable[[str, float], None] = lambda stage, part: None,
) -> Simulated:
    """The nominal run and, with runs, random ones of this plan or of plans at swept values.

    Results do not depend on `jobs`. Raises UsageError for a world that cannot be, MissingSolver
    without MuJoCo.
    """
    weights = link_masses(plan, asked.conditions)
    if weights is None and plan.robot_texts.urdf and asked.conditions.limb_mass_share is None:
        _log.warning(
            "%s does not say what the links of its URDF weigh, as plans of before: they have %g %% "
            "of the mass together; plan it again, or give --limb-mass-share",
            plan.name,
            100 * LIMB_MASS_SHARE,
        )
    links = None if weights is None else float(weights.mass.sum())
    require_possible(asked.conditions, plan.robot.mass, links)
    load_mujoco()
    camera = open_camera(plan.trajectory.com) if asked.pictures else "no pictures asked for"
    watch = camera.watch if isinstance(camera, Camera) else None
    conditions = asked.conditions
    run = simulate(plan, conditions, lambda part: progress("simulate", part), watch, rests=True)
    if isinstance(camera, Camera):
        camera.close()
    compared = compare(plan, run)
    trials: tuple[Trial, ...] = ()
    points: tuple[SweepPoint, ...] = ()
    if asked.sweep_key:
        what = Sweep(
            asked.sweep_key, asked.sweep_values, conditions, max(asked.runs, 1), asked.seed,
            asked.jobs, asked.most_backlash,
        )  # fmt: skip
        points = sweep(plan, what, lambda part: progress("sweep", part))
    elif asked.runs:
        worlds = drawn_conditions(plan, conditions, asked.runs, asked.seed, asked.most_backlash)
        trials = run_trials(
            partial(climb_trial, plan), worlds, asked.jobs, lambda part: progress("runs", part)
        )
    judged, rare, worst = None, None, None
    if asked.worlds and asked.rare:
        rare = rare_falls(
            plan, conditions, asked.worlds, asked.seed, asked.jobs,
            lambda part: progress("worlds", part),
        )  # fmt: skip
    elif asked.worlds:
        judged = judge_plan(
            plan, conditions, asked.engine, asked.worlds, asked.seed, asked.jobs,
            lambda part: progress("worlds", part),
        )  # fmt: skip
        if isinstance(camera, Camera):
            worst = _worst(plan, judged, conditions)
    return Simulated(
        plan, run, compared, trials, asked.sweep_key, points, camera, judged, rare, worst
    )


def _worst(plan: ClimbPlan, judged: Judged, base: Conditions) -> WorstWorld | None:
    """The worst of the worlds as a film; None where it cannot be drawn."""
    camera = open_camera(plan.trajectory.com)
    if not isinstance(camera, Camera):
        return None
    number = judged.worst
    run = simulate(plan, world_conditions(judged, base, number), watch=camera.watch)
    camera.close()
    return WorstWorld(number, run, camera.film())


def headline(found: Simulated) -> str:
    """The run in one line."""
    run, compared = found.run, found.compared
    end = f"falls at {run.time[-1]:.1f} s" if run.fallen else "no fall"
    error = compared.torque_error
    if not len(compared.instant):
        torque = "no instant reached"
    elif not error.size:
        torque = "no torque planned"
    else:
        torque = f"torque {np.median(error):.1%} off (median)"
    lost = f"{len(compared.losses)} contacts lost, " if compared.losses else ""
    held = compared.friction < compared.mu
    words = f"below mu at {held.mean():.1%} of contacts" if held.size else "unknown"
    return f"{end}, {len(compared.slips)} slips, {lost}{torque}, friction {words}"
