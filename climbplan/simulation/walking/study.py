"""A walk simulated and told: with feedback, with forces as planned, and in random worlds."""

from __future__ import annotations

import csv
import io
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np

from climbplan.errors import UsageError
from climbplan.reports.page_parts import Card
from climbplan.simulation.climb_report import conditions_dict, spread, trial_dict
from climbplan.simulation.conditions import Conditions, require_possible
from climbplan.simulation.figures import strip
from climbplan.simulation.pictures import Camera, open_camera
from climbplan.simulation.replay import load_mujoco
from climbplan.simulation.report_files import End, Told
from climbplan.simulation.study import Asked
from climbplan.simulation.variations import Drawn, Trial, drawn_worlds, run_trials
from climbplan.simulation.walking.comparison import WalkComparison, compare_walk
from climbplan.simulation.walking.figures import forces, path
from climbplan.simulation.walking.model import TIME_STEP, hips
from climbplan.simulation.walking.replay import STIFF, WalkRun, simulate_walk
from climbplan.walking.plan import WalkPlan
from climbplan.walking.task import LEGS, POSITION

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
UNITS = {
    "path.*": "m", "tilt.*": "rad", "time": "s", "fall_time": "s", "time_step": "s",
    "overreach": "m",
    "force_error.*": "robot weights", "correction.*": "robot weights", "slips.time": "s",
    "slips.distance": "m", "lost_contacts.time": "s", "lost_contacts.duration": "s",
    "conditions.payload": "kg",
}  # fmt: skip


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
    trials: tuple[Trial, ...] = ()
    if asked.runs:
        about = Drawn(
            asked.conditions,
            LEGS,
            plan.task.body.mass,
            plan.task.step * plan.task.knots,
            CONTACT_LOSS,
        )
        worlds = drawn_worlds(about, asked.runs, asked.seed)
        trials = run_trials(
            partial(walk_trial, plan), worlds, asked.jobs, lambda part: progress("runs", part)
        )
    return SimulatedWalk(
        plan, run, compare_walk(plan, run), alone, compare_walk(plan, alone), trials, camera
    )


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
    plan, run, compared = found.plan, found.run, found.compared
    names = plan.task.body.leg_names
    loaded = compared.loaded
    return {
        "name": plan.name,
        "spec_sha256": plan.spec_sha256,
        "simulator": f"MuJoCo {load_mujoco().__version__}",
        "time_step": TIME_STEP,
        "model": MODEL,
        "judges": NOT_JUDGED,
        "integrator": plan.task.integrator,
        "conditions": conditions_dict(run.conditions),
        "fallen": run.fallen,
        "fell": run.fallen,
        "fall_time": float(run.time[-1]) if run.fallen else None,
        "time": float(run.time[-1]),
        "planned_time": plan.task.step * plan.task.knots,
        "path": spread(compared.off),
        "tilt": spread(compared.tilt),
        "force_error": spread(compared.force_error),
        "correction": spread(compared.correction),
        "overreach": compared.overreach,
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
        "slips": [
            {"limb": names[s.leg], "time": s.time, "distance": s.amount} for s in compared.slips
        ],
        "lost_contacts": [
            {"limb": names[s.leg], "time": s.time, "duration": s.amount} for s in compared.losses
        ],
        "runs": [trial_dict(trial) for trial in found.trials],
        "pictures": found.camera if isinstance(found.camera, str) else "figures/walk.png",
        "units": UNITS,
    }


def tell(found: SimulatedWalk) -> Told:
    """What stands in the files of a simulated walk."""
    plan, run, compared = found.plan, found.run, found.compared
    camera = found.camera if isinstance(found.camera, Camera) else None
    drawn = {"path": path(plan, run), "forces": forces(plan, run, compared)}
    film = None
    if camera is not None and camera.pictures:
        times = (plan.task.step * np.arange(plan.task.knots + 1)).tolist()
        drawn["walk"] = strip(camera.strip, times, plan.name)
        film = camera.film()
    return Told(
        title=f"{plan.name}: simulated",
        headline=headline(found),
        end=end_of(found),
        report=report_dict(found),
        table=contact_table(plan, run, compared),
        figures=drawn,
        film=film,
        cards=_cards(found),
        events=contact_events(plan, run, compared),
        notes=(MODEL, NOT_JUDGED),
    )


def end_of(found: SimulatedWalk) -> End:
    """How the nominal run ended; feet of a trot may land a few hundredths of a second late."""
    run, compared = found.run, found.compared
    fall = float(run.time[-1]) if run.fallen else None
    return End(fall, len(compared.slips), len(compared.losses), allowed=LEGS)


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


def contact_events(plan: WalkPlan, run: WalkRun, compared: WalkComparison) -> list[tuple[str, str]]:
    """When which toe slid or did not touch, and the fall."""
    names = plan.task.body.leg_names
    events = [
        (s.time, f"{names[s.leg]} slides, {1e3 * s.amount:.0f} mm in all") for s in compared.slips
    ] + [
        (s.time, f"{names[s.leg]} does not touch for {1e3 * s.amount:.0f} ms")
        for s in compared.losses
    ]
    if run.fallen:
        events.append((float(run.time[-1]), "the robot falls"))
    return [(f"{time:.2f} s", words) for time, words in sorted(events)]


def contact_table(plan: WalkPlan, run: WalkRun, compared: WalkComparison) -> str:
    """One row a loaded leg and sample."""
    stream = io.StringIO()
    table = csv.writer(stream, lineterminator="\n")
    table.writerow(
        ["sample", "time_s", "limb", "pressure_planned_N", "pressure_N", "mu_critical_planned",
         "mu_critical", "mu", "correction_N"]
    )  # fmt: skip
    for n, leg in np.argwhere(compared.loaded):
        values = (
            plan.trajectory.force[n, leg, 2], run.pressure[n, leg],
            compared.friction_planned[n, leg], compared.friction[n, leg], compared.mu,
            float(np.linalg.norm(run.correction[n, leg])),
        )  # fmt: skip
        name = plan.task.body.leg_names[leg]
        table.writerow([int(n), f"{run.time[n]:.3f}", name, *(f"{v:.6g}" for v in values)])
    return stream.getvalue()


def _draw_legs(plan: WalkPlan, mujoco: Any, scene: Any, data: Any) -> None:
    """Legs as lines from the body to the toes, which the model has no geoms for."""
    rotation = data.body("body").xmat.reshape(3, 3)
    tops = data.body("body").xpos + hips(plan) @ rotation.T
    for leg in range(LEGS):
        if scene.ngeom >= scene.maxgeom:
            return
        geom = scene.geoms[scene.ngeom]
        color = np.array([0.35, 0.55, 0.80, 1.0], np.float32)
        shape = mujoco.mjtGeom.mjGEOM_CAPSULE
        mujoco.mjv_initGeom(geom, shape, np.zeros(3), np.zeros(3), np.zeros(9), color)
        mujoco.mjv_connector(geom, shape, 0.012, tops[leg], data.geom(f"toe{leg}").xpos)
        scene.ngeom += 1
