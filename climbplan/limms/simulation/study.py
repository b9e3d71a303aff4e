"""A plan of modules simulated and told."""

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
from climbplan.limms.simulation.figures import loads, way
from climbplan.limms.simulation.model import STIFF, TIME_STEP, light_share
from climbplan.limms.simulation.replay import REACHED, ModuleRun, simulate_modules
from climbplan.reports.page_parts import Card
from climbplan.simulation.asked import Asked
from climbplan.simulation.conditions import Conditions
from climbplan.simulation.mujoco_loading import load_mujoco
from climbplan.simulation.pictures import Camera, open_camera
from climbplan.simulation.report_files import End, Told, conditions_dict, spread, strip
from climbplan.store.csv_file import SafeWriter

MODEL = (
    "Modules as chains of seven links, a servo in each joint "
    f"({STIFF:g} N m/rad) that gets planned angles and speeds and the torques that the plan's "
    "checker finds for them. Ends hold on by constraints, welded where they are when the plan "
    f"closes them (a miss beyond {1e3 * REACHED:.0f} mm stays open). The box stands on the ground "
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
    "what driving asks of wheels, and latches' own play."
)
UNITS = {
    "path.*": "m", "tilt.*": "rad", "bend.*": "rad", "time": "s", "fall_time": "s",
    "time_step": "s", "torque_error.*": "N m", "torque.*": "N m", "latch_force_error.*": "N",
    "latch_misses.*": "m", "contacts.force*": "N", "contacts.moment*": "N m", "broken.time": "s",
    "goal_error": "m", "module_mass": "kg", "conditions.payload": "kg",
}  # fmt: skip


@dataclass(frozen=True)
class ModulesEnd(End):
    """How a run of modules ended: the box, and contacts that did not hold."""

    @property
    def words(self) -> str:
        """ "delivered", "delivered with 2 contacts that did not hold", "lost at 4.2 s"."""
        if self.fall_time is not None:
            return f"box lost at {self.fall_time:.2f} s"
        count = self.lost_contacts
        told = f" with {count} contact{'s' * (count > 1)} that did not hold"
        return "delivered" + (told if count else "")

    def failure(self, most: int | None) -> str:
        """Why the plan does not hold in the simulation, "" if it does; most: contacts let pass."""
        limit = self.allowed if most is None else most
        if self.fall_time is not None or self.lost_contacts > limit:
            return f"{self.words}"
        return ""


@dataclass(frozen=True)
class SimulatedModules:
    """Everything one call of the command found."""

    plan: LimmsPlan
    run: ModuleRun
    compared: ModuleComparison
    camera: Camera | str


def simulate_module_plan(
    plan: LimmsPlan,
    asked: Asked,
    progress: Callable[[str, float], None] = lambda stage, part: None,
) -> SimulatedModules:
    """The nominal run.

    Raises UsageError for what only climbs and walks have, MissingSolver without MuJoCo.
    """
    _refuse(plan, asked)
    load_mujoco()
    camera: Camera | str = "no pictures asked for"
    begin = _begins(plan)
    if asked.pictures:
        path = _brought(plan)[begin:]
        camera = open_camera(path, azimuth=140.0)
        if isinstance(camera, Camera):
            camera.view.distance *= 0.75  # a module is a metre long, not two
    watch = _shown_from(plan, camera, begin) if isinstance(camera, Camera) else None
    run = simulate_modules(
        plan, asked.conditions, progress=lambda part: progress("simulate", part), watch=watch
    )
    if isinstance(camera, Camera):
        camera.close()
    return SimulatedModules(plan, run, compare_modules(run), camera)


def _brought(plan: LimmsPlan) -> Array:
    """Where the box is (T, 3) that moves, or that moved last [m]."""
    position = plan.motion.box_position
    moving = plan.motion.box_mode != 1
    now = np.where(moving.any(axis=1), moving.argmax(axis=1), -1)
    last = np.maximum.accumulate(np.where(now >= 0, np.arange(len(now)), 0))
    which = np.maximum(now[last], 0)
    path: Array = position[np.arange(len(position)), which]
    return path


def _begins(plan: LimmsPlan) -> int:
    """The sample from which pictures are taken: a second before the box moves."""
    motion = plan.motion
    moving = np.flatnonzero((motion.box_mode != 1).any(axis=1))
    begin = float(motion.time[moving[0]]) - 1.0 if len(moving) else 0.0
    return min(int(np.searchsorted(motion.time, begin)), len(motion.time) - 2)


def _shown_from(plan: LimmsPlan, camera: Camera, begin: int) -> Callable[[int, Any, Any], None]:
    """Pictures as even in time as the run's samples allow, numbered as the camera does."""
    time = plan.motion.time
    due = list(camera.samples)

    def watch(_: int, model: Any, data: Any) -> None:
        while due and data.time >= float(time[begin + due[0]]) - 1e-6:
            number = due.pop(0)
            if not due or data.time < float(time[begin + due[0]]) - 1e-6:
                camera.watch(number, model, data)

    return watch


def _refuse(plan: LimmsPlan, asked: Asked) -> None:
    """What modules are not simulated with."""
    base, given = Conditions(), asked.conditions
    for flag, there in (
        ("--runs", asked.runs > 0),
        ("--sweep", bool(asked.sweep_key)),
        ("--worlds", asked.worlds > 0),
        ("--backlash-deg", given.backlash > 0),
        ("--random-backlash-deg", asked.most_backlash > 0),
        ("--limb-mass-share", given.limb_mass_share != base.limb_mass_share),
        ("--no-limb-weights", not given.limb_weights),
        ("--armature", (given.armature, given.armature_value) != (1.0, None)),
        ("--damping", (given.damping, given.damping_value) != (1.0, None)),
        ("--regulate", given.regulator != base.regulator),
        ("--speed", given.speed != base.speed),
    ):
        if there:
            raise UsageError(f"{flag}: plans of modules are simulated as they are, once")
    for name in ("friction", "payload", "gain"):
        if not np.isfinite(vars(given)[name]):
            raise UsageError(f"--{name} {vars(given)[name]}: expected a finite number")
    least = -0.95 * float(plan.box_mass[: plan.deliveries].min())
    if given.payload < least:
        raise UsageError(f"--payload {given.payload:g}: expected at least {least:.3g} kg")


def end_of(found: SimulatedModules) -> End:
    """How the run ended."""
    run = found.run
    fall = float(run.time[-1]) if run.lost else None
    return ModulesEnd(fall, 0, len(run.broken), allowed=0)


def headline(found: SimulatedModules) -> str:
    """The run in one line."""
    run, compared = found.run, found.compared
    off = f"box at most {1e3 * compared.off.max():.1f} mm off, {1e3 * compared.off[-1]:.1f} mm "
    torque = f"torques at most {compared.torque_off.max():.2g} N m off"
    words = f"{end_of(found).words}, {off}at the end, {torque}"
    if run.broken:
        words += f"; first {run.broken[0].words} at {run.broken[0].time:.2f} s"
    return words


def report_dict(found: SimulatedModules) -> dict[str, Any]:
    """Key figures as JSON-ready values, SI units."""
    plan, run, compared = found.plan, found.run, found.compared
    return {
        "name": plan.name,
        "spec_sha256": plan.spec_sha256,
        "simulator": f"MuJoCo {load_mujoco().__version__}",
        "time_step": TIME_STEP,
        "model": MODEL,
        "masses": _masses(plan),
        "judges": JUDGED,
        "massless": plan.massless,
        "module_mass": run.module.mass,
        "conditions": conditions_dict(run.conditions),
        "fallen": run.lost,
        "fell": run.lost,
        "fall_time": float(run.time[-1]) if run.lost else None,
        "time": float(run.time[-1]),
        "planned_time": float(plan.motion.time[-1]),
        "path": spread(compared.off),
        "goal_error": None if run.lost else _missed(found),
        "tilt": spread(run.tilt),
        "bend": spread(run.bend),
        "torque": {
            "planned": float(np.abs(run.planned_torque).max()),
            "simulated": float(np.abs(run.torque).max()),
            "limit": None if plan.massless else run.module.max_torque,
        },
        "torque_error": spread(compared.torque_off),
        "latch_force_error": spread(compared.force_off),
        "latch_misses": spread(run.misses),
        "contacts": [dict(vars(borne)) for borne in compared.borne],
        "limits": None
        if plan.massless
        else {"force": run.module.max_force, "moment": run.module.latch_moment},
        "broken": [dict(vars(broken)) for broken in run.broken],
        "slips": [],
        "lost_contacts": [{"contact": b.name, "time": b.time} for b in run.broken],
        "runs": [],
        "pictures": found.camera if isinstance(found.camera, str) else "figures/modules.png",
        "units": UNITS,
    }


def _masses(plan: LimmsPlan) -> str:
    """What modules weigh in the simulation, in words."""
    return MASSLESS.format(share=f"{100 * light_share(plan):.3g}%") if plan.massless else WITH_MASS


def _missed(found: SimulatedModules) -> float:
    """How far the worst box ends from its goal [m]."""
    goals = found.plan.goal[: found.plan.deliveries]
    return float(np.linalg.norm(found.run.box[-1] - goals, axis=1).max())


def tell(found: SimulatedModules) -> Told:
    """What stands in the files of a simulated plan of modules."""
    plan, run = found.plan, found.run
    camera = found.camera if isinstance(found.camera, Camera) else None
    drawn = {"way": way(plan, run), "loads": loads(plan, run)}
    film = None
    if camera is not None and camera.pictures:
        times = plan.motion.time[_begins(plan) :].tolist()
        drawn["modules"] = strip(camera.strip, times, plan.name)
        film = camera.film()
    return Told(
        title=f"{plan.name}: simulated",
        headline=headline(found),
        end=end_of(found),
        report=report_dict(found),
        table=_table(found),
        figures=drawn,
        film=film,
        cards=_cards(found),
        events=[(f"{b.time:.2f} s", b.words) for b in run.broken],
        notes=(MODEL, _masses(plan), JUDGED),
    )


def _cards(found: SimulatedModules) -> list[Card]:
    run, compared = found.run, found.compared
    worst = max(compared.borne, key=lambda borne: borne.force, default=None)
    cards = [
        Card("End", end_of(found).words, f"of {found.plan.motion.time[-1]:.2f} s"),
        Card(
            "Box",
            f"{1e3 * compared.off.max():.1f} mm off",
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


def _table(found: SimulatedModules) -> str:
    """One row a closed contact and kept sample."""
    stream = io.StringIO()
    table = SafeWriter(stream)
    table.writerow(
        ["time_s", "contact", "force_planned_N", "force_N", "moment_planned_Nm", "moment_Nm"]
    )
    rows = []
    for bearing in found.run.bearings:
        sizes = [
            np.linalg.norm(values[:, part], axis=1)
            for part in (slice(0, 3), slice(3, 6))
            for values in (bearing.planned, bearing.found)
        ]
        for k, time in enumerate(bearing.time):
            rows.append((float(time), bearing.name, *(float(size[k]) for size in sizes)))
    for time, name, *values in sorted(rows, key=lambda row: (row[0], row[1])):
        table.writerow([f"{time:.3f}", name, *(f"{value:.6g}" for value in values)])
    return stream.getvalue()
