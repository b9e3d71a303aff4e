"""A walk simulated with the whole robot and told: falls, velocity, torques, slips, pushes."""

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
from climbplan.simulation.trials import Trial
from climbplan.walking.plan.walk_plan import WalkPlan
from climbplan.walking.simulation.comparison import WalkComparison, compare_walk
from climbplan.walking.simulation.figures import forces, path, torques
from climbplan.walking.simulation.model import TIME_STEP
from climbplan.walking.simulation.study import random_walks, refuse_flags
from climbplan.walking.simulation.walk_report import (
    UNITS,
    contact_events,
    contact_table,
    end_of,
    filmed,
    walk_numbers,
)
from climbplan.walking.simulation.whole_body_control import BODY_STIFF, SWING_STIFF
from climbplan.walking.simulation.whole_replay import (
    PUSH,
    TICK,
    Pushed,
    WholeRun,
    simulate_whole,
)
from climbplan.walking.task.task import POSITION

MODEL = (
    "The whole robot: links with the masses and inertias of its URDF, joints that give at most the "
    "torque limits, toes as points. Every "
    f"{1e3 * TICK * TIME_STEP:g} ms a QP of the robot's dynamics finds torques: the body follows "
    f"its path (a spring of {BODY_STIFF:g} rad/s), toes in the air theirs ({SWING_STIFF:g} rad/s, "
    "landing as much aside as the body is off), forces stay in friction cones and near the planned "
    f"ones. Pushes are forces on the body for {1e3 * PUSH:g} ms."
)
NOT_JUDGED = (
    "Judged: falls, velocity, joint torques and speeds with the legs' own mass, slips, late or "
    "lost contacts. Not judged: motors beyond their limits of torque, collisions of legs, errors "
    "of sensors (the state is known as it is), and gaits that change when pushed."
)
_SLOWEST = 0.05  # [m/s] mean speed of a plan, below which nothing is said of how it is kept


@dataclass(frozen=True)
class SimulatedWhole:
    """Everything one call of the command found."""

    plan: WalkPlan
    run: WholeRun
    compared: WalkComparison
    trials: tuple[Trial, ...]
    camera: Camera | str

    @property
    def velocity_off(self) -> float | None:
        """How far the mean velocity is off the planned one, as a share of that."""
        run, planned = self.run, self.plan.trajectory.state
        last = run.samples - 1
        if not last:
            return None
        wanted = (planned[last, POSITION] - planned[0, POSITION])[:2] / run.time[last]
        kept = (run.com[last] - run.com[0])[:2] / run.time[last]
        size = float(np.linalg.norm(wanted))
        return float(np.linalg.norm(kept - wanted)) / size if size > _SLOWEST else None


def simulate_whole_plan(
    plan: WalkPlan,
    asked: Asked,
    progress: Callable[[str, float], None] = lambda stage, part: None,
) -> SimulatedWhole:
    """The nominal run, and random ones.

    Raises UsageError for what only climbs have, MissingSolver without MuJoCo or Pinocchio.
    """
    refuse_flags(asked, "has no part in a walk of the whole robot")
    require_possible(asked.conditions, plan.task.body.mass)
    span = plan.task.step * plan.task.knots
    pushes = tuple(Pushed(time, np.array(velocity, float)) for time, velocity in asked.pushes)
    for push in pushes:
        if not 0 <= push.time < span:
            raise UsageError(f"--push {push.time:g}: expected a time within the walk's {span:g} s")
    load_mujoco()
    camera: Camera | str = "no pictures asked for"
    if asked.pictures:
        camera = open_camera(plan.trajectory.state[:, POSITION], azimuth=120.0, follow=True)
    watch = camera.watch if isinstance(camera, Camera) else None
    run = simulate_whole(
        plan, asked.conditions, pushes, lambda part: progress("simulate", part), watch
    )
    if isinstance(camera, Camera):
        camera.close()
    trials = random_walks(plan, asked, partial(whole_trial, plan, pushes), progress)
    return SimulatedWhole(plan, run, compare_walk(plan, run), trials, camera)


def whole_trial(plan: WalkPlan, pushes: tuple[Pushed, ...], conditions: Conditions) -> Trial:
    """A walk in one world."""
    run = simulate_whole(plan, conditions, pushes)
    return Trial(conditions, run.fallen, float(run.time[-1]), len(compare_walk(plan, run).slips))


def headline(found: SimulatedWhole) -> str:
    """The run in one line."""
    run, compared = found.run, found.compared
    end = f"falls at {run.time[-1]:.2f} s" if run.fallen else "no fall"
    lost = f"{len(compared.losses)} contacts lost, " if compared.losses else ""
    off = f"body at most {1e3 * compared.off.max():.0f} mm off"
    kept = found.velocity_off
    speed = "" if kept is None else f", mean velocity {kept:.1%} off"
    torque = f"torques at most {run.torque.max():.0%} of their limits"
    fast = f"joint speeds {run.speed.max():.0%}"
    return f"{end}, {len(compared.slips)} slips, {lost}{off}{speed}, {torque}, {fast}"


def report_dict(found: SimulatedWhole) -> dict[str, Any]:
    """Key figures as JSON-ready values, SI units."""
    run = found.run
    last = max(run.samples - 1, 1)
    return {
        **walk_numbers(found.plan, run, found.compared, found.trials, found.camera),
        "model": MODEL,
        "judges": NOT_JUDGED,
        "velocity_off": found.velocity_off,
        "torque": spread(run.torque[:last].ravel()),
        "at_torque_limit": float((run.torque[:last] >= 1.0).mean()),
        "joint_speed": spread(run.speed[:last].ravel()),
        "ticks": run.ticks,
        "ticks_without_answer": run.unanswered,
        "pushes": [{"time": p.time, "velocity": p.velocity.tolist()} for p in run.pushes],
        "units": UNITS | {"torque.*": "torque limits", "joint_speed.*": "speed limits"},
    }


def tell(found: SimulatedWhole) -> Told:
    """What stands in the files of a simulated walk."""
    plan, run, compared = found.plan, found.run, found.compared
    pictures, film = filmed(plan, found.camera)
    drawn = {
        "path": path(plan, run),
        "forces": forces(plan, run, compared),
        "torques": torques(plan, run),
    } | pictures
    events = [(f"{p.time:.2f} s", _pushed(p)) for p in run.pushes]
    return Told(
        title=f"{plan.name}: simulated with the whole robot",
        headline=headline(found),
        end=end_of(plan, run, compared, float(run.speed.max(initial=0.0))),
        report=report_dict(found),
        table=contact_table(plan, run, compared),
        figures=drawn,
        film=film,
        cards=_cards(found),
        events=sorted(events + contact_events(plan, run, compared)),
        notes=(MODEL, NOT_JUDGED),
    )


def _pushed(push: Pushed) -> str:
    x, y, z = push.velocity
    return f"the body is pushed, worth ({x:g}, {y:g}, {z:g}) m/s"


def _cards(found: SimulatedWhole) -> list[Card]:
    run, compared = found.run, found.compared
    end = f"falls at {run.time[-1]:.2f} s" if run.fallen else "no fall"
    tilt = f"tilted at most {np.rad2deg(compared.tilt.max()):.1f} deg"
    kept = found.velocity_off
    limit = f"{(run.torque >= 1.0).mean():.1%} of joints and samples at it"
    return [
        Card("End", end, f"of {found.plan.task.step * found.plan.task.knots:.2f} s"),
        Card("Body", f"{1e3 * compared.off.max():.0f} mm off", tilt),
        Card("Velocity", "-" if kept is None else f"{kept:.1%} off", "mean, of the planned one"),
        Card("Torque", f"{run.torque.max():.0%} of its limit", limit),
        Card("Joint speed", f"{run.speed.max():.0%} of its limit", "at most"),
        Card("QPs", f"{run.unanswered} without answer", f"of {run.ticks}"),
    ]
