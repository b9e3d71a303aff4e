"""Simulate a climb or transition: the nominal run, and random worlds."""

from __future__ import annotations

import logging
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import numpy as np

from climbplan.climb.plan.climb_plan import ClimbPlan
from climbplan.climb.simulation.comparison import PlanComparison, compare
from climbplan.climb.simulation.model.link_masses import select_link_masses
from climbplan.climb.simulation.mujoco_run import RecordedRun
from climbplan.climb.simulation.replay import simulate
from climbplan.climb.simulation.risk.estimation import (
    RiskEstimate,
    build_world_conditions,
    estimate_risk,
)
from climbplan.climb.simulation.risk.multilevel_splitting import (
    RareEventEstimate,
    estimate_fall_probability,
)
from climbplan.climb.simulation.sweep import SweepPoint, SweepSettings, sweep
from climbplan.climb.simulation.variations import draw_conditions, run_climb_trial
from climbplan.simulation.conditions import LIMB_MASS_SHARE, Conditions, require_possible
from climbplan.simulation.mujoco_loading import load_mujoco
from climbplan.simulation.pictures import SnapshotCamera, open_camera
from climbplan.simulation.request import SimulationRequest
from climbplan.simulation.trials import RandomRun, run_trials

_log = logging.getLogger(__name__)


@dataclass(frozen=True)
class WorstWorld:
    """The world with the earliest fall or largest deviation, simulated in MuJoCo."""

    number: int
    run: RecordedRun
    film: bytes  # animated GIF

    @property
    def summary(self) -> str:
        """Text of how the robot ends."""
        return f"falls at {self.run.time[-1]:.1f} s" if self.run.fallen else "stands"


@dataclass(frozen=True)
class SimulationStudy:
    """All results of one call of the command."""

    plan: ClimbPlan
    run: RecordedRun
    comparison: PlanComparison
    trials: tuple[RandomRun, ...]
    sweep_key: str
    points: tuple[SweepPoint, ...]
    camera: SnapshotCamera | str  # with its pictures, or why there are none
    risk: RiskEstimate | None = None  # in worlds of the plan's uncertainty
    rare: RareEventEstimate | None = None  # likewise, where falls are too few to count
    worst: WorstWorld | None = None  # of those judged, where there are pictures


def simulate_plan(
    plan: ClimbPlan,
    request: SimulationRequest,
    progress: Callable[[str, float], None] = lambda stage, part: None,
) -> SimulationStudy:
    """Simulate the nominal run and, if requested, random worlds or a sweep of a spec's key.

    Results do not depend on the number of jobs.

    Raises:
        UsageError: The conditions are impossible.
        MissingSolver: MuJoCo is not installed.
    """
    _check_masses(plan, request.conditions)
    load_mujoco()
    camera = open_camera(plan.trajectory.com) if request.pictures else "no pictures asked for"
    watch_sample = camera.watch if isinstance(camera, SnapshotCamera) else None
    conditions = request.conditions
    run = simulate(
        plan, conditions, lambda part: progress("simulate", part), watch_sample, rests=True
    )
    if isinstance(camera, SnapshotCamera):
        camera.close()
    comparison = compare(plan, run)
    trials, points = _run_variations(plan, request, progress)
    risk, rare, worst = None, None, None
    if request.worlds and request.rare:
        rare = estimate_fall_probability(
            plan, conditions, request.worlds, request.seed, request.jobs,
            lambda part: progress("worlds", part),
        )  # fmt: skip
    elif request.worlds:
        risk = estimate_risk(
            plan, conditions, request.engine, request.worlds, request.seed, workers=request.jobs,
            progress=lambda part: progress("worlds", part),
        )  # fmt: skip
        if isinstance(camera, SnapshotCamera):
            worst = _film_worst(plan, risk, conditions)
    return SimulationStudy(
        plan, run, comparison, trials, request.sweep_key, points, camera, risk, rare, worst
    )


def _check_masses(plan: ClimbPlan, conditions: Conditions) -> None:
    """Warn of a plan without link masses, and raise UsageError for impossible conditions."""
    weights = select_link_masses(plan, conditions)
    if weights is None and plan.robot_texts.urdf and conditions.limb_mass_share is None:
        _log.warning(
            "%s does not say what the links of its URDF weigh, as plans of before: they have %g %% "
            "of the mass together; plan it again, or give --limb-mass-share",
            plan.name,
            100 * LIMB_MASS_SHARE,
        )
    links = None if weights is None else float(weights.mass.sum())
    require_possible(conditions, plan.robot.mass, links)


def _run_variations(
    plan: ClimbPlan, request: SimulationRequest, progress: Callable[[str, float], None]
) -> tuple[tuple[RandomRun, ...], tuple[SweepPoint, ...]]:
    """Simulate random worlds, or a sweep of a spec's key, if requested."""
    conditions = request.conditions
    trials: tuple[RandomRun, ...] = ()
    points: tuple[SweepPoint, ...] = ()
    if request.sweep_key:
        sweep_settings = SweepSettings(
            request.sweep_key, request.sweep_values, conditions, max(request.runs, 1), request.seed,
            request.jobs, request.max_backlash,
        )  # fmt: skip
        points = sweep(plan, sweep_settings, lambda part: progress("sweep", part))
    elif request.runs:
        worlds = draw_conditions(plan, conditions, request.runs, request.seed, request.max_backlash)
        trials = run_trials(
            partial(run_climb_trial, plan),
            worlds,
            request.jobs,
            lambda part: progress("runs", part),
        )
    return trials, points


def _film_worst(plan: ClimbPlan, risk: RiskEstimate, base: Conditions) -> WorstWorld | None:
    """Simulate and film the worst of the worlds; None without pictures."""
    camera = open_camera(plan.trajectory.com)
    if not isinstance(camera, SnapshotCamera):
        return None
    number = risk.worst
    run = simulate(plan, build_world_conditions(risk, base, number), watch=camera.watch)
    camera.close()
    return WorstWorld(number, run, camera.film())


def format_headline(study: SimulationStudy) -> str:
    """Format the run in one line."""
    run, comparison = study.run, study.comparison
    end_text = f"falls at {run.end_time:.1f} s" if run.fallen else "no fall"
    if run.execution is not None:
        end_text += f" in closed loop, {run.execution.duration:.1f} s"
        for replan in run.execution.replans:
            end_text += f", {replan.reason}, goes on by a plan from there"
        if run.execution.stopped:
            end_text += f", stops at {run.end_time:.1f} s: {run.execution.stopped}"
    error = comparison.torque_error
    if not len(comparison.instant):
        torque_text = "no instant reached"
    elif not error.size:
        torque_text = "no torque planned"
    else:
        torque_text = f"torque {np.median(error):.1%} off (median)"
    lost_text = (
        f"{len(comparison.lost_contacts)} contacts lost, " if comparison.lost_contacts else ""
    )
    is_below_mu = comparison.friction < comparison.mu
    friction_text = (
        f"below mu at {is_below_mu.mean():.1%} of contacts" if is_below_mu.size else "unknown"
    )
    slips_text = f"{len(comparison.slips)} slips"
    return f"{end_text}, {slips_text}, {lost_text}{torque_text}, friction {friction_text}"
