"""Simulation study of a walk with the whole robot: falls, velocity, torques, slips, pushes."""

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
from climbplan.simulation.trials import RandomRun
from climbplan.walking.plan.walk_plan import WalkPlan
from climbplan.walking.simulation.comparison import WalkComparison, compare_walk
from climbplan.walking.simulation.figures import plot_forces, plot_path, plot_torques
from climbplan.walking.simulation.mujoco_model import TIME_STEP
from climbplan.walking.simulation.rigid_body_study import reject_flags, run_random_trials
from climbplan.walking.simulation.walk_report import (
    UNITS,
    build_end,
    compute_key_figures,
    list_contact_events,
    render_pictures,
    write_contact_table,
)
from climbplan.walking.simulation.whole_body_control import BODY_FREQUENCY, SWING_FREQUENCY
from climbplan.walking.simulation.whole_body_replay import (
    PUSH_DURATION,
    STEPS_PER_TICK,
    BodyPush,
    WholeBodyRun,
    simulate_whole_body,
)
from climbplan.walking.task.task import POSITION

MODEL = (
    "The whole robot: links with the masses and inertias of its URDF, joints that give at most the "
    "torque limits, toes as points. Every "
    f"{1e3 * STEPS_PER_TICK * TIME_STEP:g} ms a QP of the robot's dynamics finds torques: the body "
    f"follows its path (a spring of {BODY_FREQUENCY:g} rad/s), toes in the air theirs "
    f"({SWING_FREQUENCY:g} rad/s, "
    "landing as much aside as the body is off), forces stay in friction cones and near the planned "
    f"ones. Pushes are forces on the body for {1e3 * PUSH_DURATION:g} ms."
)
NOT_JUDGED = (
    "Judged: falls, velocity, joint torques and speeds with the legs' own mass, slips, late or "
    "lost contacts. Not judged: motors beyond their limits of torque, collisions of legs, errors "
    "of sensors (the state is known as it is), and gaits that change when pushed."
)
_MIN_SPEED = 0.05  # [m/s] mean speed of a plan below which its error is not reported


@dataclass(frozen=True)
class SimulatedWholeBody:
    """The results of one call of the command."""

    plan: WalkPlan
    run: WholeBodyRun
    comparison: WalkComparison
    trials: tuple[RandomRun, ...]
    camera: SnapshotCamera | str

    @property
    def relative_velocity_error(self) -> float | None:
        """Error of the mean velocity relative to the planned one; None for slow plans."""
        run, planned = self.run, self.plan.trajectory.state
        last = run.samples - 1
        if not last:
            return None
        planned_velocity = (planned[last, POSITION] - planned[0, POSITION])[:2] / run.time[last]
        actual_velocity = (run.com[last] - run.com[0])[:2] / run.time[last]
        planned_speed = float(np.linalg.norm(planned_velocity))
        return (
            float(np.linalg.norm(actual_velocity - planned_velocity)) / planned_speed
            if planned_speed > _MIN_SPEED
            else None
        )


def simulate_whole_body_plan(
    plan: WalkPlan,
    request: SimulationRequest,
    progress: Callable[[str, float], None] = lambda stage, part: None,
) -> SimulatedWholeBody:
    """Simulate a walk with the whole robot, and random trials.

    Args:
        plan: the walk.
        request: options of the command.
        progress: receives stages and fractions.

    Raises:
        UsageError: options that only climbs have.
        MissingSolver: MuJoCo or Pinocchio is not installed.
    """
    reject_flags(request, "has no part in a walk of the whole robot")
    require_possible(request.conditions, plan.task.body.mass)
    span = plan.task.dt * plan.task.knots
    pushes = tuple(BodyPush(time, np.array(velocity, float)) for time, velocity in request.pushes)
    for push in pushes:
        if not 0 <= push.time < span:
            raise UsageError(f"--push {push.time:g}: expected a time within the walk's {span:g} s")
    load_mujoco()
    camera: SnapshotCamera | str = "no pictures asked for"
    if request.pictures:
        camera = open_camera(plan.trajectory.state[:, POSITION], azimuth=120.0, follow=True)
    watch = camera.watch if isinstance(camera, SnapshotCamera) else None
    run = simulate_whole_body(
        plan, request.conditions, pushes, lambda part: progress("simulate", part), watch
    )
    if isinstance(camera, SnapshotCamera):
        camera.close()
    trials = run_random_trials(plan, request, partial(run_trial, plan, pushes), progress)
    return SimulatedWholeBody(plan, run, compare_walk(plan, run), trials, camera)


def run_trial(plan: WalkPlan, pushes: tuple[BodyPush, ...], conditions: Conditions) -> RandomRun:
    """Simulate a walk with pushes under the conditions of one random world."""
    run = simulate_whole_body(plan, conditions, pushes)
    return RandomRun(
        conditions, run.fallen, float(run.time[-1]), len(compare_walk(plan, run).slips)
    )


def format_headline(walk: SimulatedWholeBody) -> str:
    """Return the result in one line."""
    run, compared = walk.run, walk.comparison
    end = f"falls at {run.time[-1]:.2f} s" if run.fallen else "no fall"
    lost = f"{len(compared.losses)} contacts lost, " if compared.losses else ""
    deviation = f"body at most {1e3 * compared.position_error.max():.0f} mm off"
    velocity_error = walk.relative_velocity_error
    speed = "" if velocity_error is None else f", mean velocity {velocity_error:.1%} off"
    torque = f"torques at most {run.torque.max():.0%} of their limits"
    joint_speed = f"joint speeds {run.speed.max():.0%}"
    return f"{end}, {len(compared.slips)} slips, {lost}{deviation}{speed}, {torque}, {joint_speed}"


def collect_key_figures(walk: SimulatedWholeBody) -> dict[str, Any]:
    """Return the key figures as JSON-ready values, SI units."""
    run = walk.run
    last = max(run.samples - 1, 1)
    return {
        **compute_key_figures(walk.plan, run, walk.comparison, walk.trials, walk.camera),
        "model": MODEL,
        "judges": NOT_JUDGED,
        "velocity_off": walk.relative_velocity_error,
        "torque": summarise_values(run.torque[:last].ravel()),
        "at_torque_limit": float((run.torque[:last] >= 1.0).mean()),
        "joint_speed": summarise_values(run.speed[:last].ravel()),
        "ticks": run.num_ticks,
        "ticks_without_answer": run.num_unsolved,
        "pushes": [{"time": p.time, "velocity": p.velocity.tolist()} for p in run.pushes],
        "units": UNITS | {"torque.*": "torque limits", "joint_speed.*": "speed limits"},
    }


def build_report(walk: SimulatedWholeBody) -> SimulationRecord:
    """Return the content of all files of a simulated walk."""
    plan, run, compared = walk.plan, walk.run, walk.comparison
    pictures, film = render_pictures(plan, walk.camera)
    figures = {
        "path": plot_path(plan, run),
        "forces": plot_forces(plan, run, compared),
        "torques": plot_torques(plan, run),
    } | pictures
    events = [(f"{p.time:.2f} s", _describe_push(p)) for p in run.pushes]
    return SimulationRecord(
        title=f"{plan.name}: simulated with the whole robot",
        headline=format_headline(walk),
        end=build_end(plan, run, compared, float(run.speed.max(initial=0.0))),
        report=collect_key_figures(walk),
        table=write_contact_table(plan, run, compared),
        figures=figures,
        film=film,
        cards=_build_cards(walk),
        events=sorted(events + list_contact_events(plan, run, compared)),
        notes=(MODEL, NOT_JUDGED),
    )


def _describe_push(push: BodyPush) -> str:
    """Return the text of a push in the list of events."""
    x, y, z = push.velocity
    return f"the body is pushed, worth ({x:g}, {y:g}, {z:g}) m/s"


def _build_cards(walk: SimulatedWholeBody) -> list[Card]:
    """Return the cards of the report."""
    run, compared = walk.run, walk.comparison
    end = f"falls at {run.time[-1]:.2f} s" if run.fallen else "no fall"
    tilt = f"tilted at most {np.rad2deg(compared.tilt.max()):.1f} deg"
    velocity_error = walk.relative_velocity_error
    limit = f"{(run.torque >= 1.0).mean():.1%} of joints and samples at it"
    return [
        Card("End", end, f"of {walk.plan.task.dt * walk.plan.task.knots:.2f} s"),
        Card("Body", f"{1e3 * compared.position_error.max():.0f} mm off", tilt),
        Card(
            "Velocity",
            "-" if velocity_error is None else f"{velocity_error:.1%} off",
            "mean, of the planned one",
        ),
        Card("Torque", f"{run.torque.max():.0%} of its limit", limit),
        Card("Joint speed", f"{run.speed.max():.0%} of its limit", "at most"),
        Card("QPs", f"{run.num_unsolved} without answer", f"of {run.num_ticks}"),
    ]
