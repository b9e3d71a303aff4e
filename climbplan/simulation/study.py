"""A plan simulated: the nominal run, what it says, random worlds, and their figures."""

from __future__ import annotations

import csv
import io
import json
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from climbplan.plans.climb_plan import ClimbPlan
from climbplan.reports.sheet import png
from climbplan.robots.rotations import Array
from climbplan.simulation.comparison import LEAST_SAG, LEAST_TORQUE, Comparison, compare
from climbplan.simulation.conditions import Conditions
from climbplan.simulation.figures import falls, leg, sag, strip
from climbplan.simulation.model import TIME_STEP
from climbplan.simulation.pictures import Camera, open_camera
from climbplan.simulation.replay import Run, load_mujoco, simulate
from climbplan.simulation.variations import (
    SweepPoint,
    Trial,
    drawn_conditions,
    run_trials,
    sweep,
)

RESULT = "simulation.csv"
UNITS = {
    "torque.*": "N m", "sag.*": "m", "time": "s", "time_step": "s", "final_offset": "m",
    "slips.time": "s", "slips.distance": "m", "lost_contacts.time": "s",
    "lost_contacts.duration": "s", "conditions.payload": "kg",
    "conditions.backlash": "rad",
}  # fmt: skip


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


def simulate_plan(
    plan: ClimbPlan,
    conditions: Conditions,
    *,
    runs: int = 0,
    sweep_key: str = "",
    sweep_values: Sequence[float] = (),
    seed: int = 0,
    pictures: bool = True,
    progress: Callable[[str, float], None] = lambda stage, part: None,
) -> Simulated:
    """The nominal run and, with runs, random ones of this plan or of plans at swept values.

    Raises MissingSolver without MuJoCo.
    """
    load_mujoco()
    camera = open_camera(plan) if pictures else "no pictures asked for"
    watch = camera.watch if isinstance(camera, Camera) else None
    run = simulate(plan, conditions, lambda part: progress("simulate", part), watch, rests=True)
    compared = compare(plan, run)
    trials: tuple[Trial, ...] = ()
    points: tuple[SweepPoint, ...] = ()
    if sweep_key:
        points = sweep(
            plan, sweep_key, sweep_values, conditions, max(runs, 1), seed,
            lambda part: progress("sweep", part),
        )  # fmt: skip
    elif runs:
        worlds = drawn_conditions(plan, conditions, runs, seed)
        trials = run_trials(plan, worlds, lambda part: progress("runs", part))
    return Simulated(plan, run, compared, trials, sweep_key, points, camera)


def headline(found: Simulated) -> str:
    """The run in one line."""
    run, compared = found.run, found.compared
    end = f"falls at {run.time[-1]:.1f} s" if run.fallen else "no fall"
    error = compared.torque_error
    torque = f"torque {np.median(error):.1%} off (median)" if error.size else "no instant reached"
    lost = f"{len(compared.losses)} contacts lost, " if compared.losses else ""
    return (
        f"{end}, {len(compared.slips)} slips, {lost}{torque}, friction {_friction_words(compared)}"
    )


def _friction_words(compared: Comparison) -> str:
    held = compared.friction < compared.mu
    return f"below mu at {held.mean():.1%} of contacts" if held.size else "unknown"


def report_dict(found: Simulated) -> dict[str, Any]:
    """Key figures as JSON-ready values, SI units."""
    plan, run, compared = found.plan, found.run, found.compared
    names = plan.robot.limb_names
    finite = np.isfinite(compared.sag_predicted).all(axis=1)
    return {
        "name": plan.name,
        "spec_sha256": plan.spec_sha256,
        "simulator": f"MuJoCo {load_mujoco().__version__}",
        "time_step": TIME_STEP,
        "conditions": _conditions(run.conditions),
        "fallen": run.fallen,
        "time": float(run.time[-1]),
        "planned_time": float(plan.trajectory.time[-1]),
        "instants": {"planned": plan.instants.count, "reached": len(compared.instant)},
        "torque": {
            "relative_error": _spread(compared.torque_error),
            "least_compared": LEAST_TORQUE,
            "largest": float(np.abs(run.torque).max()),
            "largest_planned": float(np.abs(plan.forces.joint_torques).max()),
        },
        "friction": {
            "critical": _spread(compared.friction[compared.friction > 0]),
            "planned": _spread(compared.friction_planned[compared.friction_planned > 0]),
            "below_mu": float((compared.friction < compared.mu).mean())
            if compared.friction.size
            else None,
        },
        "sag": {
            "simulated": _spread(np.linalg.norm(compared.sag, axis=1)),
            "predicted": _spread(np.linalg.norm(compared.sag_predicted[finite], axis=1)),
            "relative_error": _spread(compared.sag_error),
            "absolute_error": _spread(
                np.linalg.norm(compared.sag - compared.sag_predicted, axis=1)
            ),
            "compared_above": LEAST_SAG,
            "compared": len(compared.sag_error),
            "lag": _spread(np.linalg.norm(compared.lag, axis=1)),
        },
        "final_offset": (run.com[-1] - plan.trajectory.com[run.samples - 1]).tolist(),
        "bumps": float(run.bumped.mean()),
        "slips": [
            {
                "limb": names[s.limb],
                "time": s.time,
                "where": "start" if s.instant < 0 else plan.instants.label(s.instant, names),
                "distance": s.distance,
            }
            for s in compared.slips
        ],
        "lost_contacts": [
            {
                "limb": names[s.limb],
                "time": s.time,
                "where": plan.instants.label(s.instant, names),
                "duration": s.duration,
            }
            for s in compared.losses
        ],
        "runs": [_trial(trial) for trial in found.trials],
        "sweep": {
            "key": found.sweep_key,
            "points": [_point(point) for point in found.points],
        },
        "pictures": found.camera if isinstance(found.camera, str) else "figures/climb.png",
        "units": UNITS,
    }


def write_report(found: Simulated, directory: Path) -> None:
    """Write report.json, simulation.csv and figures/ into a directory."""
    text = json.dumps(report_dict(found), indent=2, allow_nan=False, ensure_ascii=False)
    (directory / "report.json").write_text(f"{text}\n", encoding="utf-8")
    (directory / RESULT).write_text(_table(found), encoding="utf-8")
    folder = directory / "figures"
    folder.mkdir()
    for name, figure in _figures(found).items():
        (folder / f"{name}.png").write_bytes(png(figure))


def _figures(found: Simulated) -> dict[str, Figure]:
    plan = found.plan
    out = {f"leg_{limb + 1}": leg(plan, found.run, limb) for limb in range(plan.robot.limb_count)}
    out["sag"] = sag(plan, found.run, found.compared)
    if found.points:
        out["falls"] = falls(found.points, found.sweep_key, plan.name)
    if isinstance(found.camera, Camera) and found.camera.pictures:
        out["climb"] = strip(found.camera.pictures, plan.trajectory.time.tolist(), plan.name)
    return out


def _table(found: Simulated) -> str:
    """One row a standing limb at each instant reached."""
    plan, compared = found.plan, found.compared
    stream = io.StringIO()
    table = csv.writer(stream, lineterminator="\n")
    table.writerow(
        ["instant", "time_s", "limb", "torque_planned_Nm", "torque_Nm", "mu_critical_planned",
         "mu_critical", "mu"]
    )  # fmt: skip
    for row, k in enumerate(compared.instant):
        for limb, name in enumerate(plan.robot.limb_names):
            if plan.instants.contact[k, limb]:
                values = (
                    compared.torque_planned, compared.torque, compared.friction_planned,
                    compared.friction, compared.mu,
                )  # fmt: skip
                cells = [f"{v[row, limb]:.6g}" for v in values]
                table.writerow(
                    [int(k), f"{found.run.time[compared.sample[row]]:.3f}", name, *cells]
                )
    return stream.getvalue()


def _spread(values: Array) -> dict[str, float | None]:
    """Median and range of finite values."""
    kept = values[np.isfinite(values)]
    if not kept.size:
        return {"median": None, "least": None, "most": None}
    return {"median": float(np.median(kept)), "least": float(kept.min()), "most": float(kept.max())}


def _conditions(conditions: Conditions) -> dict[str, Any]:
    plain = {k: v for k, v in vars(conditions).items() if k != "losses"}
    losses = [{"limb": x.limb, "start": x.start, "duration": x.duration} for x in conditions.losses]
    return {**plain, "losses": losses}


def _trial(trial: Trial) -> dict[str, Any]:
    return {
        "fallen": trial.fallen,
        "time": trial.time,
        "slips": trial.slips,
        "conditions": _conditions(trial.conditions),
    }


def _point(point: SweepPoint) -> dict[str, Any]:
    low, high = point.share.interval
    return {
        "value": point.value,
        "no_plan": point.no_plan,
        "fallen": point.share.fallen,
        "runs": point.share.runs,
        "share": point.share.value,
        "lower": low,
        "upper": high,
        "trials": [_trial(trial) for trial in point.trials],
    }
