"""Simulation study of a walk as one rigid body: feedback, open loop, and random worlds."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np

from climbplan.errors import UsageError
from climbplan.reports.page_parts import Card
from climbplan.simulation.conditions import Conditions, require_possible
from climbplan.simulation.mujoco_loading import load_mujoco
from climbplan.simulation.pictures import SnapshotCamera, open_camera
from climbplan.simulation.report_files import SimulationRecord, summarise_values
from climbplan.simulation.request import SimulationRequest
from climbplan.simulation.trials import (
    ConditionsDistribution,
    RandomRun,
    run_trials,
    sample_conditions,
)
from climbplan.walking.plan.walk_plan import WalkPlan
from climbplan.walking.simulation.comparison import WalkComparison, compare_walk
from climbplan.walking.simulation.figures import plot_forces, plot_path
from climbplan.walking.simulation.mujoco_model import compute_hips
from climbplan.walking.simulation.replay import FEEDBACK_FREQUENCY, WalkRun, simulate_walk
from climbplan.walking.simulation.walk_report import (
    build_end,
    compute_key_figures,
    list_contact_events,
    render_pictures,
    write_contact_table,
)
from climbplan.walking.task.task import POSITION

MODEL = (
    "One rigid body with massless legs and point feet, as the plan has it: legs push with the "
    "planned contact forces, feet stand on the ground by friction alone, and contacts come and go "
    "by physics. Forces are corrected for the body's departure from its path (a spring and damper "
    f"of {FEEDBACK_FREQUENCY:g} rad/s, within the friction and force limits that the plan was made "
    "with)."
)
NOT_JUDGED = (
    "Judged: rigid-body dynamics in continuous time, friction, slips, late or lost contacts, "
    "falls, and how much correction the plan needs. Not judged: joint torques and speeds, the mass "
    "and collisions of legs; reach only by how far standing feet leave their workspace boxes."
)
CONTACT_LOSS = 0.04  # [s] for which one toe has no friction in random worlds: half a knot


@dataclass(frozen=True)
class SimulatedWalk:
    """The results of one call of the command."""

    plan: WalkPlan
    run: WalkRun
    comparison: WalkComparison
    open_loop: WalkRun  # with planned forces, without correction
    open_loop_comparison: WalkComparison
    trials: tuple[RandomRun, ...]
    camera: SnapshotCamera | str


def simulate_walk_plan(
    plan: WalkPlan,
    request: SimulationRequest,
    progress: Callable[[str, float], None] = lambda stage, part: None,
) -> SimulatedWalk:
    """Simulate a walk with and without feedback, and random trials.

    Args:
        plan: the walk.
        request: options of the command.
        progress: receives stages and fractions.

    Raises:
        UsageError: options that only climbs have.
        MissingSolver: MuJoCo is not installed.
    """
    reject_flags(request, "a walk is simulated as one rigid body without joints")
    if (request.conditions.armature, request.conditions.armature_value) != (1.0, None):
        raise UsageError("--armature: a walk of one rigid body has no joints")
    if request.pushes:
        raise UsageError("--push: a walk of one rigid body is pushed by its spec (`loop.pushes`)")
    require_possible(request.conditions, plan.task.body.mass)
    load_mujoco()
    com = plan.trajectory.state[:, POSITION]
    camera: SnapshotCamera | str = "no pictures asked for"
    if request.pictures:
        camera = open_camera(com, azimuth=120.0, follow=True, decorate=partial(_draw_legs, plan))
    watch = camera.watch if isinstance(camera, SnapshotCamera) else None
    run = simulate_walk(
        plan, request.conditions, progress=lambda part: progress("simulate", part), watch=watch
    )
    if isinstance(camera, SnapshotCamera):
        camera.close()
    open_loop = simulate_walk(plan, request.conditions, feedback=False)
    trials = run_random_trials(plan, request, partial(run_trial, plan), progress)
    return SimulatedWalk(
        plan, run, compare_walk(plan, run), open_loop, compare_walk(plan, open_loop), trials, camera
    )


def run_random_trials(
    plan: WalkPlan,
    request: SimulationRequest,
    trial: Callable[[Conditions], RandomRun],
    progress: Callable[[str, float], None],
) -> tuple[RandomRun, ...]:
    """Run the requested random trials."""
    if not request.runs:
        return ()
    span = plan.task.dt * plan.task.knots
    distribution = ConditionsDistribution(
        request.conditions, plan.task.body.leg_count, plan.task.body.mass, span, CONTACT_LOSS
    )
    worlds = sample_conditions(distribution, request.runs, request.seed)
    return run_trials(trial, worlds, request.jobs, lambda part: progress("runs", part))


def reject_flags(request: SimulationRequest, reason: str) -> None:
    """Raise UsageError with a reason for options that walks do not have."""
    base, conditions = Conditions(), request.conditions
    if request.sweep_key:
        raise UsageError("--sweep: plans of kind mpc have no safety factors; it sweeps climbs")
    for flag, is_set in (
        ("--worlds", request.worlds > 0),
        ("--gain", conditions.gain != base.gain),
        ("--backlash-deg", conditions.backlash > 0),
        ("--random-backlash-deg", request.max_backlash > 0),
        ("--limb-mass-share", conditions.limb_mass_share != base.limb_mass_share),
        ("--no-limb-weights", not conditions.limb_weights),
        ("--damping", (conditions.damping, conditions.damping_value) != (1.0, None)),
        ("--regulate", conditions.regulator != base.regulator),
        ("--closed-loop", conditions.closed_loop),
        ("--speed", conditions.speed != base.speed),
    ):
        if is_set:
            raise UsageError(f"{flag}: {reason}")


def run_trial(plan: WalkPlan, conditions: Conditions) -> RandomRun:
    """Simulate a walk under the conditions of one random world."""
    run = simulate_walk(plan, conditions)
    return RandomRun(
        conditions, run.fallen, float(run.time[-1]), len(compare_walk(plan, run).slips)
    )


def format_headline(walk: SimulatedWalk) -> str:
    """Return the result in one line."""
    run, compared = walk.run, walk.comparison
    end = f"falls at {run.time[-1]:.2f} s" if run.fallen else "no fall"
    lost = f"{len(compared.losses)} contacts lost, " if compared.losses else ""
    deviation = f"body at most {1e3 * compared.position_error.max():.0f} mm off"
    open_loop = f"{1e3 * walk.open_loop_comparison.position_error.max():.0f} mm"
    if walk.open_loop.fallen:
        open_loop += f" and a fall at {walk.open_loop.time[-1]:.2f} s"
    corrections = f"corrections {compute_median(compared.correction):.1%} of the weight (median)"
    contacts = f"{len(compared.slips)} slips, {lost}{deviation}"
    return f"{end}, {contacts}, {corrections}; without them {open_loop}"


def compute_median(values: Any) -> float:
    """Return the median, 0 of no values."""
    return float(np.median(values)) if len(values) else 0.0


def collect_key_figures(walk: SimulatedWalk) -> dict[str, Any]:
    """Return the key figures as JSON-ready values, SI units."""
    run, compared = walk.run, walk.comparison
    loaded = compared.loaded
    return {
        **compute_key_figures(walk.plan, run, compared, walk.trials, walk.camera),
        "model": MODEL,
        "judges": NOT_JUDGED,
        "friction": {
            "critical": summarise_values(compared.friction[loaded]),
            "planned": summarise_values(compared.friction_planned[loaded]),
            "below_mu": float((compared.friction < compared.mu)[loaded].mean())
            if loaded.any()
            else None,
        },
        "without_feedback": {
            "fallen": walk.open_loop.fallen,
            "time": float(walk.open_loop.time[-1]),
            "path": summarise_values(walk.open_loop_comparison.position_error),
            "tilt": summarise_values(walk.open_loop_comparison.tilt),
        },
    }


def build_report(walk: SimulatedWalk) -> SimulationRecord:
    """Return the content of all files of a simulated walk."""
    plan, run, compared = walk.plan, walk.run, walk.comparison
    pictures, film = render_pictures(plan, walk.camera)
    figures = {"path": plot_path(plan, run), "forces": plot_forces(plan, run, compared)} | pictures
    return SimulationRecord(
        title=f"{plan.name}: simulated",
        headline=format_headline(walk),
        end=build_end(plan, run, compared),
        report=collect_key_figures(walk),
        table=write_contact_table(plan, run, compared),
        figures=figures,
        film=film,
        cards=_build_cards(walk),
        events=list_contact_events(plan, run, compared),
        notes=(MODEL, NOT_JUDGED),
    )


def _build_cards(walk: SimulatedWalk) -> list[Card]:
    """Return the cards of the report."""
    run, compared = walk.run, walk.comparison
    end = f"falls at {run.time[-1]:.2f} s" if run.fallen else "no fall"
    tilt = f"tilted at most {np.rad2deg(compared.tilt.max()):.1f} deg"
    open_loop = f"{1e3 * walk.open_loop_comparison.position_error.max():.0f} mm off"
    return [
        Card("End", end, f"of {walk.plan.task.dt * walk.plan.task.knots:.2f} s"),
        Card("Body", f"{1e3 * compared.position_error.max():.0f} mm off", tilt),
        Card(
            "Contact forces",
            f"{compute_median(compared.force_error):.1%} off",
            "of the weight, median",
        ),
        Card("Corrections", f"{compute_median(compared.correction):.1%}", "of the weight, median"),
        Card("Without corrections", open_loop, "falls" if walk.open_loop.fallen else "no fall"),
        Card("Overreach", f"{1e3 * compared.overreach:.0f} mm", "of standing feet"),
    ]


def _draw_legs(plan: WalkPlan, mujoco: Any, scene: Any, data: Any) -> None:
    """Draw legs as lines from body to toes, because the model has no geoms for them."""
    rotation = data.body("body").xmat.reshape(3, 3)
    tops = data.body("body").xpos + compute_hips(plan) @ rotation.T
    for leg in range(plan.task.body.leg_count):
        if scene.ngeom >= scene.maxgeom:
            return
        geom = scene.geoms[scene.ngeom]
        color = np.array([0.35, 0.55, 0.80, 1.0], np.float32)
        shape = mujoco.mjtGeom.mjGEOM_CAPSULE
        mujoco.mjv_initGeom(geom, shape, np.zeros(3), np.zeros(3), np.zeros(9), color)
        mujoco.mjv_connector(geom, shape, 0.012, tops[leg], data.geom(f"toe{leg}").xpos)
        scene.ngeom += 1
