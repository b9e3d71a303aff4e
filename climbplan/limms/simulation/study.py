"""Simulation of a plan of modules, and its report."""

from __future__ import annotations

import io
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from climbplan.arrays import Array
from climbplan.errors import UsageError
from climbplan.limms.plan.limms_plan import LimmsPlan
from climbplan.limms.simulation.comparison import ModuleComparison, compare_modules
from climbplan.limms.simulation.figures import plot_loads, plot_path
from climbplan.limms.simulation.model import STIFFNESS, TIME_STEP, compute_mass_fraction
from climbplan.limms.simulation.replay import MAX_MISS, ModuleRun, simulate_modules
from climbplan.reports.page_parts import Card
from climbplan.simulation.conditions import Conditions
from climbplan.simulation.mujoco_loading import load_mujoco
from climbplan.simulation.pictures import SnapshotCamera, open_camera
from climbplan.simulation.report_files import (
    SimulationEnd,
    SimulationRecord,
    convert_conditions,
    plot_film_strip,
    summarise_values,
)
from climbplan.simulation.request import SimulationRequest
from climbplan.store.csv_file import SafeWriter

MODEL = (
    "Modules as chains of seven links, a servo in each joint "
    f"({STIFFNESS:g} N m/rad) that gets planned angles and speeds and the torques that the plan's "
    "checker finds for them. Ends hold on by constraints, welded where they are when the plan "
    f"closes them (a miss beyond {1e3 * MAX_MISS:.0f} mm stays open). The box stands on the ground "
    "by contact and friction."
)
WITH_MASS = (
    "Modules weigh what they do. A latch that bears more force or moment than it holds breaks; an "
    "end on the ground that is pulled, pushed aside or tipped lets go; joints give what they can."
)
MASSLESS = (
    "A massless plan: each module is simulated with {share} of the box's mass, and nothing breaks. "
    "The plan is told apart from the hardware: `verify` says what latches and joints would have to "
    "hold if modules weighed what they do."
)
JUDGED = (
    "Judged: rigid-body dynamics of box and modules in continuous time, where ends are as latches "
    "close, what latches bear, joint torques, where the box ends. Not judged: collisions of links, "
    "what driving asks of wheels, and the latches' own backlash."
)
UNITS = {
    "path.*": "m", "tilt.*": "rad", "bend.*": "rad", "time": "s", "fall_time": "s",
    "time_step": "s", "torque_error.*": "N m", "torque.*": "N m", "latch_force_error.*": "N",
    "latch_misses.*": "m", "contacts.force*": "N", "contacts.moment*": "N m", "broken.time": "s",
    "goal_error": "m", "module_mass": "kg", "conditions.payload": "kg",
}  # fmt: skip


@dataclass(frozen=True)
class ModulesEnd(SimulationEnd):
    """How a run of modules ended: the box, and contacts that did not hold."""

    @property
    def words(self) -> str:
        """ "delivered", "delivered with 2 contacts that did not hold", "lost at 4.2 s"."""
        if self.fall_time is not None:
            return f"box lost at {self.fall_time:.2f} s"
        count = self.lost_contacts
        lost_text = f" with {count} contact{'s' * (count > 1)} that did not hold"
        return "delivered" + (lost_text if count else "")

    def failure(self, max_slips: int | None) -> str:
        """Return why the simulated plan fails, "" if it does not; `max_slips` contacts may fail."""
        limit = self.allowed if max_slips is None else max_slips
        if self.fall_time is not None or self.lost_contacts > limit:
            return f"{self.words}"
        return ""


@dataclass(frozen=True)
class SimulatedModules:
    """The results of one simulation."""

    plan: LimmsPlan
    run: ModuleRun
    compared: ModuleComparison
    camera: SnapshotCamera | str


def simulate_module_plan(
    plan: LimmsPlan,
    asked: SimulationRequest,
    progress: Callable[[str, float], None] = lambda stage, fraction: None,
) -> SimulatedModules:
    """Simulate the nominal run.

    Raises:
        UsageError: Options that only climbs and walks have.
        MissingSolver: MuJoCo is not installed.
    """
    _check_request(plan, asked)
    load_mujoco()
    camera: SnapshotCamera | str = "no pictures asked for"
    first_sample = _find_first_sample(plan)
    if asked.pictures:
        path = _find_moving_box(plan)[first_sample:]
        camera = open_camera(path, azimuth=140.0)
        if isinstance(camera, SnapshotCamera):
            camera.view.distance *= 0.75  # a module is a metre long, not two
    watch = (
        _build_watcher(plan, camera, first_sample) if isinstance(camera, SnapshotCamera) else None
    )
    run = simulate_modules(
        plan,
        asked.conditions,
        progress=lambda fraction: progress("simulate", fraction),
        watch=watch,
    )
    if isinstance(camera, SnapshotCamera):
        camera.close()
    return SimulatedModules(plan, run, compare_modules(run), camera)


def _find_moving_box(plan: LimmsPlan) -> Array:
    """Return the position (T, 3) of the box that moves, or moved last [m]."""
    position = plan.motion.box_position
    moving = plan.motion.box_mode != 1
    moving_box = np.where(moving.any(axis=1), moving.argmax(axis=1), -1)
    last = np.maximum.accumulate(np.where(moving_box >= 0, np.arange(len(moving_box)), 0))
    box = np.maximum(moving_box[last], 0)
    path: Array = position[np.arange(len(position)), box]
    return path


def _find_first_sample(plan: LimmsPlan) -> int:
    """Return the first sample of pictures, one second before the box moves."""
    motion = plan.motion
    moving = np.flatnonzero((motion.box_mode != 1).any(axis=1))
    start = float(motion.time[moving[0]]) - 1.0 if len(moving) else 0.0
    return min(int(np.searchsorted(motion.time, start)), len(motion.time) - 2)


def _build_watcher(
    plan: LimmsPlan, camera: SnapshotCamera, begin: int
) -> Callable[[int, Any, Any], None]:
    """Return a callback that takes pictures evenly in time, by the numbers of the camera."""
    time = plan.motion.time
    due = list(camera.samples)

    def watch(_: int, model: Any, data: Any) -> None:
        while due and data.time >= float(time[begin + due[0]]) - 1e-6:
            number = due.pop(0)
            if not due or data.time < float(time[begin + due[0]]) - 1e-6:
                camera.watch(number, model, data)

    return watch


def _check_request(plan: LimmsPlan, asked: SimulationRequest) -> None:
    """Raise an error for options that do not apply to modules."""
    base, conditions = Conditions(), asked.conditions
    for flag, is_set in (
        ("--runs", asked.runs > 0),
        ("--sweep", bool(asked.sweep_key)),
        ("--worlds", asked.worlds > 0),
        ("--backlash-deg", conditions.backlash > 0),
        ("--random-backlash-deg", asked.max_backlash > 0),
        ("--limb-mass-share", conditions.limb_mass_share != base.limb_mass_share),
        ("--no-limb-weights", not conditions.limb_weights),
        ("--armature", (conditions.armature, conditions.armature_value) != (1.0, None)),
        ("--damping", (conditions.damping, conditions.damping_value) != (1.0, None)),
        ("--regulate", conditions.regulator != base.regulator),
        ("--closed-loop", conditions.closed_loop),
        ("--speed", conditions.speed != base.speed),
    ):
        if is_set:
            raise UsageError(
                f"{flag}: expected no such option: plans of modules are simulated once, as they are"
            )
    for name in ("friction", "payload", "gain"):
        if not np.isfinite(vars(conditions)[name]):
            raise UsageError(f"--{name} {vars(conditions)[name]}: expected a finite number")
    min_payload = -0.95 * float(plan.box_mass[: plan.deliveries].min())
    if conditions.payload < min_payload:
        raise UsageError(
            f"--payload {conditions.payload:g}: expected at least {min_payload:.3g} kg"
        )


def describe_end(simulated: SimulatedModules) -> SimulationEnd:
    """Return how the run ended."""
    run = simulated.run
    fall = float(run.time[-1]) if run.lost else None
    return ModulesEnd(fall, 0, len(run.broken), allowed=0)


def format_headline(simulated: SimulatedModules) -> str:
    """Return the run in one line."""
    run, compared = simulated.run, simulated.compared
    largest, final = 1e3 * compared.box_error.max(), 1e3 * compared.box_error[-1]
    box_text = f"box at most {largest:.1f} mm off, {final:.1f} mm "
    torque = f"torques at most {compared.torque_error.max():.2g} N m off"
    text = f"{describe_end(simulated).words}, {box_text}at the end, {torque}"
    if run.broken:
        text += f"; first {run.broken[0].words} at {run.broken[0].time:.2f} s"
    return text


def build_report_data(simulated: SimulatedModules) -> dict[str, Any]:
    """Return key figures as JSON-ready values in SI units."""
    plan, run, compared = simulated.plan, simulated.run, simulated.compared
    return {
        "name": plan.name,
        "spec_sha256": plan.spec_sha256,
        "simulator": f"MuJoCo {load_mujoco().__version__}",
        "time_step": TIME_STEP,
        "model": MODEL,
        "masses": _describe_masses(plan),
        "judges": JUDGED,
        "massless": plan.massless,
        "module_mass": run.module.mass,
        "conditions": convert_conditions(run.conditions),
        "fallen": run.lost,
        "fell": run.lost,
        "fall_time": float(run.time[-1]) if run.lost else None,
        "time": float(run.time[-1]),
        "planned_time": float(plan.motion.time[-1]),
        "path": summarise_values(compared.box_error),
        "goal_error": None if run.lost else _compute_goal_error(simulated),
        "tilt": summarise_values(run.tilt),
        "bend": summarise_values(run.bend),
        "torque": {
            "planned": float(np.abs(run.planned_torque).max()),
            "simulated": float(np.abs(run.torque).max()),
            "limit": None if plan.massless else run.module.max_torque,
        },
        "torque_error": summarise_values(compared.torque_error),
        "latch_force_error": summarise_values(compared.force_error),
        "latch_misses": summarise_values(run.misses),
        "contacts": [dict(vars(borne)) for borne in compared.contacts],
        "limits": None
        if plan.massless
        else {"force": run.module.max_force, "moment": run.module.latch_moment},
        "broken": [dict(vars(broken)) for broken in run.broken],
        "slips": [],
        "lost_contacts": [{"contact": b.name, "time": b.time} for b in run.broken],
        "runs": [],
        "pictures": simulated.camera
        if isinstance(simulated.camera, str)
        else "figures/modules.png",
        "units": UNITS,
    }


def _describe_masses(plan: LimmsPlan) -> str:
    """Return a note on the masses of modules in the simulation."""
    return (
        MASSLESS.format(share=f"{100 * compute_mass_fraction(plan):.3g}%")
        if plan.massless
        else WITH_MASS
    )


def _compute_goal_error(simulated: SimulatedModules) -> float:
    """Return the largest final distance of a box from its goal [m]."""
    goals = simulated.plan.goal[: simulated.plan.deliveries]
    return float(np.linalg.norm(simulated.run.box[-1] - goals, axis=1).max())


def build_report(simulated: SimulatedModules) -> SimulationRecord:
    """Build the record of a simulated plan of modules."""
    plan, run = simulated.plan, simulated.run
    camera = simulated.camera if isinstance(simulated.camera, SnapshotCamera) else None
    figures = {"way": plot_path(plan, run), "loads": plot_loads(plan, run)}
    film = None
    if camera is not None and camera.pictures:
        times = plan.motion.time[_find_first_sample(plan) :].tolist()
        figures["modules"] = plot_film_strip(camera.strip, times, plan.name)
        film = camera.film()
    return SimulationRecord(
        title=f"{plan.name}: simulated",
        headline=format_headline(simulated),
        end=describe_end(simulated),
        report=build_report_data(simulated),
        table=_build_table(simulated),
        figures=figures,
        film=film,
        cards=_build_cards(simulated),
        events=[(f"{b.time:.2f} s", b.words) for b in run.broken],
        notes=(MODEL, _describe_masses(plan), JUDGED),
    )


def _build_cards(simulated: SimulatedModules) -> list[Card]:
    """Return the cards of the page."""
    run, compared = simulated.run, simulated.compared
    worst = max(compared.contacts, key=lambda borne: borne.force, default=None)
    cards = [
        Card("End", describe_end(simulated).words, f"of {simulated.plan.motion.time[-1]:.2f} s"),
        Card(
            "Box",
            f"{1e3 * compared.box_error.max():.1f} mm off",
            f"tilted at most {np.rad2deg(run.tilt.max()):.2f} deg",
        ),
        Card(
            "Latches close",
            f"{1e3 * run.misses.max(initial=0.0):.1f} mm off",
            f"the worst of {len(run.misses)}",
        ),
        Card(
            "Torque",
            f"{np.abs(run.torque).max():.3g} N m",
            f"planned {np.abs(run.planned_torque).max():.3g} N m, the most of any joint",
        ),
    ]
    if worst is not None:
        planned = f"planned {worst.force_planned:.3g} N, {worst.name}"
        cards.append(Card("Largest force", f"{worst.force:.3g} N", planned))
    return cards


def _build_table(simulated: SimulatedModules) -> str:
    """Return a table with one row for each closed contact and recorded sample."""
    stream = io.StringIO()
    table = SafeWriter(stream)
    table.writerow(
        ["time_s", "contact", "force_planned_N", "force_N", "moment_planned_Nm", "moment_Nm"]
    )
    rows = []
    for bearing in simulated.run.bearings:
        sizes = [
            np.linalg.norm(values[:, components], axis=1)
            for components in (slice(0, 3), slice(3, 6))
            for values in (bearing.planned, bearing.found)
        ]
        for k, time in enumerate(bearing.time):
            rows.append((float(time), bearing.name, *(float(size[k]) for size in sizes)))
    for time, name, *values in sorted(rows, key=lambda row: (row[0], row[1])):
        table.writerow([f"{time:.3f}", name, *(f"{value:.6g}" for value in values)])
    return stream.getvalue()
