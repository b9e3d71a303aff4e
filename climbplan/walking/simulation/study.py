"""A walk simulated and told: with feedback, with forces as planned, and in random worlds."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np

from climbplan.errors import UsageError
from climbplan.reports.page_parts import Card
from climbplan.simulation.asked import Asked
from climbplan.simulation.conditions import Conditions, require_possible
from climbplan.simulation.mujoco_loading import load_mujoco
from climbplan.simulation.pictures import Camera, open_camera
from climbplan.simulation.report_files import Told, spread
from climbplan.simulation.trials import Drawn, Trial, drawn_worlds, run_trials
from climbplan.walking.plan.walk_plan import WalkPlan
from climbplan.walking.simulation.comparison import WalkComparison, compare_walk
from climbplan.walking.simulation.figures import forces, path
from climbplan.walking.simulation.model import hips
from climbplan.walking.simulation.replay import STIFF, WalkRun, simulate_walk
from climbplan.walking.simulation.walk_report import (
    contact_events,
    contact_table,
    end_of,
    filmed,
    walk_numbers,
)
from climbplan.walking.task.task import POSITION

MODEL = (
    "One rigid body with massless legs and point feet, as the plan has it: legs push with the "
    "planned contact forces, feet stand on the ground by friction alone, and contacts come and go "
    "by physics. Forces are corrected for the body's departure from its path (a spring and damper "
    f"of {STIFF:g} rad/s, within the friction and force limits that the plan was made with)."
)
NOT_JUDGED = (
    "Judged: rigid-body dynamics in continuous time, friction, slips, late or lost contacts, "
    "falls, and how much correction the plan needs. Not judged: joint torques and speeds, the mass "
    "and collisions of legs; reach only by how far standing feet leave their workspace boxes."
)
CONTACT_LOSS = 0.04  # [s] for which one toe has no friction in random worlds: half a knot


@dataclass(frozen=True)
class SimulatedWalk:
    """Everything one call of the command found."""

    plan: WalkPlan
    run: WalkRun
    compared: WalkComparison
    alone: WalkRun  # with forces as planned, without correction
    compared_alone: WalkComparison
    trials: tuple[Trial, ...]
    camera: Camera | str


def simulate_walk_plan(
    plan: WalkPlan,
    asked: Asked,
    progress: Callable[[str, float], None] = lambda stage, part: None,
) -> SimulatedWalk:
    """The nominal run with and without feedback, and random ones.

    Raises UsageError for what only climbs have, MissingSolver without MuJoCo.
    """
    refuse_flags(asked, "a walk is simulated as one rigid body without joints")
    if (asked.conditions.armature, asked.conditions.armature_value) != (1.0, None):
        raise UsageError("--armature: a walk of one rigid body has no joints")
    if asked.pushes:
        raise UsageError("--push: a walk of one rigid body is pushed by its spec (`loop.pushes`)")
    require_possible(asked.conditions, plan.task.body.mass)
    load_mujoco()
    com = plan.trajectory.state[:, POSITION]
    camera: Camera | str = "no pictures asked for"
    if asked.pictures:
        camera = open_camera(com, azimuth=120.0, follow=True, decorate=partial(_draw_legs, plan))
    watch = camera.watch if isinstance(camera, Camera) else None
    run = simulate_walk(
        plan, asked.conditions, progress=lambda part: progress("simulate", part), watch=watch
    )
    if isinstance(camera, Camera):
        camera.close()
    alone = simulate_walk(plan, asked.conditions, feedback=False)
    trials = random_walks(plan, asked, partial(walk_trial, plan), progress)
    return SimulatedWalk(
        plan, run, compare_walk(plan, run), alone, compare_walk(plan, alone), trials, camera
    )


def random_walks(
    plan: WalkPlan,
    asked: Asked,
    trial: Callable[[Conditions], Trial],
    progress: Callable[[str, float], None],
) -> tuple[Trial, ...]:
    """The random runs that are asked for."""
    if not asked.runs:
        return ()
    span = plan.task.step * plan.task.knots
    about = Drawn(
        asked.conditions, plan.task.body.leg_count, plan.task.body.mass, span, CONTACT_LOSS
    )
    worlds = drawn_worlds(about, asked.runs, asked.seed)
    return run_trials(trial, worlds, asked.jobs, lambda part: progress("runs", part))


def refuse_flags(asked: Asked, why: str) -> None:
    """What walks do not have; raises UsageError with the reason."""
    base, given = Conditions(), asked.conditions
    if asked.sweep_key:
        raise UsageError("--sweep: plans of kind mpc have no safety factors; it sweeps climbs")
    for flag, there in (
        ("--worlds", asked.worlds > 0),
        ("--gain", given.gain != base.gain),
        ("--backlash-deg", given.backlash > 0),
        ("--random-backlash-deg", asked.most_backlash > 0),
        ("--limb-mass-share", given.limb_mass_share != base.limb_mass_share),
        ("--no-limb-weights", not given.limb_weights),
        ("--damping", (given.damping, given.damping_value) != (1.0, None)),
        ("--regulate", given.regulator != base.regulator),
        ("--speed", given.speed != base.speed),
    ):
        if there:
            raise UsageError(f"{flag}: {why}")


def walk_trial(plan: WalkPlan, conditions: Conditions) -> Trial:
    """A walk in one world."""
    run = simulate_walk(plan, conditions)
    return Trial(conditions, run.fallen, float(run.time[-1]), len(compare_walk(plan, run).slips))


def headline(found: SimulatedWalk) -> str:
    """The run in one line."""
    run, compared = found.run, found.compared
    end = f"falls at {run.time[-1]:.2f} s" if run.fallen else "no fall"
    lost = f"{len(compared.losses)} contacts lost, " if compared.losses else ""
    off = f"body at most {1e3 * compared.off.max():.0f} mm off"
    alone = f"{1e3 * found.compared_alone.off.max():.0f} mm"
    if found.alone.fallen:
        alone += f" and a fall at {found.alone.time[-1]:.2f} s"
    words = f"corrections {_median(compared.correction):.1%} of the weight (median)"
    return f"{end}, {len(compared.slips)} slips, {lost}{off}, {words}; without them {alone}"


def _median(values: Any) -> float:
    return float(np.median(values)) if len(values) else 0.0


def report_dict(found: SimulatedWalk) -> dict[str, Any]:
    """Key figures as JSON-ready values, SI units."""
    run, compared = found.run, found.compared
    loaded = compared.loaded
    return {
        **walk_numbers(found.plan, run, compared, found.trials, found.camera),
        "model": MODEL,
        "judges": NOT_JUDGED,
        "friction": {
            "critical": spread(compared.friction[loaded]),
            "planned": spread(compared.friction_planned[loaded]),
            "below_mu": float((compared.friction < compared.mu)[loaded].mean())
            if loaded.any()
            else None,
        },
        "without_feedback": {
            "fallen": found.alone.fallen,
            "time": float(found.alone.time[-1]),
            "path": spread(found.compared_alone.off),
            "tilt": spread(found.compared_alone.tilt),
        },
    }


def tell(found: SimulatedWalk) -> Told:
    """What stands in the files of a simulated walk."""
    plan, run, compared = found.plan, found.run, found.compared
    pictures, film = filmed(plan, found.camera)
    drawn = {"path": path(plan, run), "forces": forces(plan, run, compared)} | pictures
    return Told(
        title=f"{plan.name}: simulated",
        headline=headline(found),
        end=end_of(plan, run, compared),
        report=report_dict(found),
        table=contact_table(plan, run, compared),
        figures=drawn,
        film=film,
        cards=_cards(found),
        events=contact_events(plan, run, compared),
        notes=(MODEL, NOT_JUDGED),
    )


def _cards(found: SimulatedWalk) -> list[Card]:
    run, compared = found.run, found.compared
    end = f"falls at {run.time[-1]:.2f} s" if run.fallen else "no fall"
    tilt = f"tilted at most {np.rad2deg(compared.tilt.max()):.1f} deg"
    alone = f"{1e3 * found.compared_alone.off.max():.0f} mm off"
    return [
        Card("End", end, f"of {found.plan.task.step * found.plan.task.knots:.2f} s"),
        Card("Body", f"{1e3 * compared.off.max():.0f} mm off", tilt),
        Card("Contact forces", f"{_median(compared.force_error):.1%} off", "of the weight, median"),
        Card("Corrections", f"{_median(compared.correction):.1%}", "of the weight, median"),
        Card("Without corrections", alone, "falls" if found.alone.fallen else "no fall"),
        Card("Overreach", f"{1e3 * compared.overreach:.0f} mm", "of standing feet"),
    ]


def _draw_legs(plan: WalkPlan, mujoco: Any, scene: Any, data: Any) -> None:
    """Legs as lines from the body to the toes, which the model has no geoms for."""
    rotation = data.body("body").xmat.reshape(3, 3)
    tops = data.body("body").xpos + hips(plan) @ rotation.T
    for leg in range(plan.task.body.leg_count):
        if scene.ngeom >= scene.maxgeom:
            return
        geom = scene.geoms[scene.ngeom]
        color = np.array([0.35, 0.55, 0.80, 1.0], np.float32)
        shape = mujoco.mjtGeom.mjGEOM_CAPSULE
        mujoco.mjv_initGeom(geom, shape, np.zeros(3), np.zeros(3), np.zeros(9), color)
        mujoco.mjv_connector(geom, shape, 0.012, tops[leg], data.geom(f"toe{leg}").xpos)
        scene.ngeom += 1
