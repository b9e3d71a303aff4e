"""Report of a simulated climb or transition: report.json, table, figures and page."""

from __future__ import annotations

import io
import sys
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from climbplan.climb.plan.file import write_climb
from climbplan.climb.simulation.comparison import MIN_SAG, PlanComparison
from climbplan.climb.simulation.executive.settings import describe_event
from climbplan.climb.simulation.figures import plot_falls, plot_leg, plot_sag
from climbplan.climb.simulation.grips.gripping import GripReport
from climbplan.climb.simulation.model.mjcf import TIME_STEP
from climbplan.climb.simulation.mujoco_run import ExecutionRecord
from climbplan.climb.simulation.risk.estimation import build_risk_dict
from climbplan.climb.simulation.risk.figure import plot_causes
from climbplan.climb.simulation.risk.multilevel_splitting import build_rare_dict
from climbplan.climb.simulation.study import SimulationStudy, WorstWorld, format_headline
from climbplan.climb.simulation.sweep import SweepPoint
from climbplan.reports.page_parts import Card
from climbplan.simulation.mujoco_loading import load_mujoco
from climbplan.simulation.pictures import SnapshotCamera
from climbplan.simulation.report_files import (
    WORST_FILM,
    SimulationEnd,
    SimulationRecord,
    convert_conditions,
    convert_trial,
    plot_film_strip,
    summarise_values,
)
from climbplan.store.csv_file import SafeWriter

UNITS = {
    "torque.*": "N m", "sag.*": "m", "time": "s", "fall_time": "s", "time_step": "s",
    "worst_world.time": "s",
    "final_offset": "m", "grips.missed": "m", "grips.let_go.time": "s",
    "slips.time": "s", "slips.distance": "m", "lost_contacts.time": "s",
    "lost_contacts.duration": "s", "execution.duration": "s", "execution.step_time.*": "s",
    "execution.replans.planning_time": "s", "execution.replans.duration": "s",
    "execution.events.time": "s", "execution.events.clock": "s", "conditions.payload": "kg",
    "conditions.backlash": "rad", "conditions.armature_value": "kg m^2",
    "conditions.damping_value": "N m s/rad",
}  # fmt: skip


def build_report(study: SimulationStudy) -> SimulationRecord:
    """Build the contents of a simulation's files."""
    plan = study.plan
    camera = study.camera if isinstance(study.camera, SnapshotCamera) else None
    film = camera.film() if camera is not None and camera.pictures else None
    return SimulationRecord(
        title=f"{plan.name}: simulated",
        headline=format_headline(study),
        end=compute_end(study),
        report=build_report_dict(study),
        table=_format_table(study),
        figures=_build_figures(study),
        film=film,
        cards=_build_cards(study),
        events=_list_events(study),
        notes=_select_notes(study),
        plans=_collect_replans(study.run.execution),
        worlds="" if study.risk is None else study.risk.stands,
        worst=None if study.worst is None else (_describe_worst(study.worst), study.worst.film),
    )


def _collect_replans(execution: ExecutionRecord | None) -> dict[str, Callable[[Path], None]]:
    """Return what writes the plans that a robot went on by, by file name."""
    replans = () if execution is None else execution.replans
    return {
        _name_replan(number): partial(write_climb, replan.plan)
        for number, replan in enumerate(replans, 1)
    }


def _describe_worst(worst: WorstWorld) -> str:
    return f"World {worst.number}, the worst of those drawn, in MuJoCo: the robot {worst.summary}"


def compute_end(study: SimulationStudy) -> SimulationEnd:
    """Compute how the nominal run ended; sliding or separating toes are not planned."""
    run, comparison = study.run, study.comparison
    fall = run.end_time if run.fallen else None
    execution = run.execution
    return SimulationEnd(
        fall,
        len(comparison.slips),
        len(comparison.lost_contacts),
        allowed=0 if execution is None else sys.maxsize,  # which closed loop is there for
        stopped="" if execution is None or run.fallen else execution.stopped,
    )


_MODEL = (
    "Joints are position servos with the plan's stiffness and torque limits; commands are played "
    "as they stand, but for what a regulator adds (--regulate). Contacts are MuJoCo's, stiff and "
    "with Coulomb friction; surfaces do not give way."
)
_GRIPS = (
    "Grippers are welded to their holds where they reach them and drawn on to them; wrists bring "
    "the planned torques, fingers the planned gripping force. A grip lets go where palm and "
    "fingers, each within friction and spines (their lower bound), can in no way share what it "
    "bears."
)
_JUDGES = (
    "Judged: torques, friction, slips, lost contacts, falls, and the sag of the body once it is at "
    "rest at each instant. Not judged: wear of surfaces, motor heating, flexible links beyond the "
    "plan's compliance."
)


_CLOSED_LOOP = (
    "In closed loop commands follow from joint angles and motor torques, measured with noise and "
    "an error of scale for each motor. The plan's clock waits for touch-downs and unloaded limbs, "
    "so that times of the plan are not those of the run."
)


def _select_notes(study: SimulationStudy) -> tuple[str, ...]:
    run = study.run
    grips = () if run.grips is None else (_GRIPS,)
    loop = () if run.execution is None else (_CLOSED_LOOP,)
    return (_MODEL, *grips, *loop, _JUDGES)


def _build_cards(study: SimulationStudy) -> list[Card]:
    comparison = study.comparison
    torque_error, sag_error = comparison.torque_error, comparison.sag_error
    friction = comparison.friction[np.isfinite(comparison.friction)]
    reached_text = f"{len(comparison.instant)} of {study.plan.instants.count} instants reached"
    cards = [
        Card(
            "End",
            f"falls at {study.run.end_time:.1f} s" if study.run.fallen else "no fall",
            reached_text,
        )
    ]
    if torque_error.size:
        cards.append(Card("Worst motor's torque", f"{np.median(torque_error):.1%} off", "median"))
    if friction.size:
        friction_text = f"{friction.max():.2f}"
        planned = f"planned {comparison.friction_planned.max():.2f}"
        cards.append(Card("Largest critical friction", friction_text, planned))
    if sag_error.size:
        off = 1e3 * float(
            np.nanmedian(np.linalg.norm(comparison.sag - comparison.sag_predicted, axis=1))
        )
        detail = (
            f"median distance to the static equilibrium; {np.median(sag_error):.0%} of its sag "
            f"where that is over a millimetre ({sag_error.size} instants)"
        )
        cards.append(Card("Sag", f"{off:.1f} mm off", detail))
    if study.run.grips is not None and study.run.grips.misses.size:
        num_lost, largest_miss = len(study.run.grips.failures), study.run.grips.misses.max()
        detail = f"holds at most {1e3 * largest_miss:.0f} mm beside them when they close"
        cards.append(Card("Grips that let go", str(num_lost) if num_lost else "none", detail))
    if study.risk is not None:
        low, high = study.risk.interval
        fallen = f"{study.risk.falls} of {len(study.risk.outcomes)}"
        detail = f"{study.risk.engine}, 95 % interval {low:.1%} to {high:.1%}"
        cards.append(Card("Worlds that fall", fallen, detail))
    if study.rare is not None:
        low, high = study.rare.interval
        detail = f"statics, splitting, 95 % interval {low:.1e} to {high:.1e}"
        cards.append(Card("Probability of a fall", f"{study.rare.probability:.1e}", detail))
    return cards


def _list_events(study: SimulationStudy) -> list[tuple[str, str]]:
    plan, comparison = study.plan, study.comparison
    names = plan.robot.limb_names
    events = [
        (slip.time, f"{names[slip.limb]} slides, {1e3 * slip.distance:.0f} mm in all")
        for slip in comparison.slips
    ] + [
        (lost.time, f"{names[lost.limb]} does not touch for {lost.duration:.1f} s")
        for lost in comparison.lost_contacts
    ]
    if study.run.grips is not None:
        events += [(x.time, f"{names[x.limb]} {x.message}") for x in study.run.grips.failures]
    if study.run.execution is not None:
        events += [
            (event.clock, describe_event(event, names))
            for event in study.run.execution.events
            if event.kind in ("returned", "retreated", "stopped")
        ]
    if study.run.fallen:
        events.append((study.run.end_time, "the robot falls"))
    return [(f"{time:.1f} s", message) for time, message in sorted(events)]


def build_report_dict(study: SimulationStudy) -> dict[str, Any]:
    """Build the key figures as JSON-ready values, SI units."""
    plan, run, comparison = study.plan, study.run, study.comparison
    names = plan.robot.limb_names
    return {
        "name": plan.name,
        "spec_sha256": plan.spec_sha256,
        "simulator": f"MuJoCo {load_mujoco().__version__}",
        "time_step": TIME_STEP,
        "conditions": convert_conditions(run.conditions),
        "fallen": run.fallen,
        "fell": run.fallen,
        "fall_time": run.end_time if run.fallen else None,
        "time": float(run.time[-1]),
        "planned_time": float(plan.trajectory.time[-1]),
        "instants": {"planned": plan.instants.count, "reached": len(comparison.instant)},
        "torque": {
            "relative_error": summarise_values(comparison.torque_error),
            "least_compared": comparison.min_torque,
            "largest": float(np.abs(run.torque).max()),
            "largest_planned": float(np.abs(plan.forces.motor_torques).max()),
        },
        "friction": _build_friction_dict(comparison),
        "sag": _build_sag_dict(comparison),
        "final_offset": (run.com[-1] - plan.trajectory.com[run.samples - 1]).tolist(),
        "bumps": float(run.bumped.mean()),
        "slips": [
            {
                "limb": names[s.limb],
                "time": s.time,
                "where": "start" if s.instant < 0 else plan.instants.label(s.instant, names),
                "distance": s.distance,
            }
            for s in comparison.slips
        ],
        "lost_contacts": [
            {
                "limb": names[s.limb],
                "time": s.time,
                "where": plan.instants.label(s.instant, names),
                "duration": s.duration,
            }
            for s in comparison.lost_contacts
        ],
        "execution": None if run.execution is None else _build_execution_dict(run.execution, names),
        "grips": None if run.grips is None else _build_grips_dict(run.grips, names),
        "worlds": None if study.risk is None else build_risk_dict(study.risk, names, plan),
        "worst_world": None if study.worst is None else _build_worst_dict(study.worst),
        "rare": None if study.rare is None else build_rare_dict(study.rare),
        "runs": [convert_trial(trial) for trial in study.trials],
        "sweep": {
            "key": study.sweep_key,
            "points": [_build_point_dict(point) for point in study.points],
        },
        "pictures": study.camera if isinstance(study.camera, str) else "figures/climb.png",
        "units": UNITS,
    }


def _build_friction_dict(comparison: PlanComparison) -> dict[str, Any]:
    is_below = comparison.friction < comparison.mu
    return {
        "critical": summarise_values(comparison.friction[comparison.friction > 0]),
        "planned": summarise_values(comparison.friction_planned[comparison.friction_planned > 0]),
        "below_mu": float(is_below.mean()) if comparison.friction.size else None,
    }


def _build_sag_dict(comparison: PlanComparison) -> dict[str, Any]:
    finite = np.isfinite(comparison.sag_predicted).all(axis=1)
    return {
        "simulated": summarise_values(np.linalg.norm(comparison.sag, axis=1)),
        "predicted": summarise_values(np.linalg.norm(comparison.sag_predicted[finite], axis=1)),
        "relative_error": summarise_values(comparison.sag_error),
        "absolute_error": summarise_values(
            np.linalg.norm(comparison.sag - comparison.sag_predicted, axis=1)
        ),
        "compared_above": MIN_SAG,
        "compared": len(comparison.sag_error),
        "lag": summarise_values(np.linalg.norm(comparison.lag, axis=1)),
    }


def _build_worst_dict(worst: WorstWorld) -> dict[str, Any]:
    return {
        "world": worst.number,
        "fallen": worst.run.fallen,
        "time": float(worst.run.time[-1]),
        "film": WORST_FILM,
    }


def _name_replan(number: int) -> str:
    """Return the file of a plan from a measured stance."""
    return f"replanned_{number}.h5"


def _build_execution_dict(execution: ExecutionRecord, names: Sequence[str]) -> dict[str, Any]:
    return {
        "stopped": execution.stopped,
        "duration": execution.duration,
        "step_time": summarise_values(execution.step_times),
        "replans": [
            {
                "reason": replan.reason,
                "planning_time": replan.planning_time,
                "duration": replan.duration,
                "rounds": replan.plan.rounds.count,
                "plan": _name_replan(number),
            }
            for number, replan in enumerate(execution.replans, 1)
        ],
        "events": [
            {
                "time": event.time,
                "clock": event.clock,
                "kind": event.kind,
                "limb": names[event.limb] if event.limb >= 0 else None,
                "value": event.value,
            }
            for event in execution.events
        ],
    }


def _build_grips_dict(grips: GripReport, names: Sequence[str]) -> dict[str, Any]:
    return {
        "closed": int(grips.misses.size),
        "missed": summarise_values(grips.misses),
        "let_go": [
            {"limb": names[x.limb], "time": x.time, "words": x.message} for x in grips.failures
        ],
    }


def _build_figures(study: SimulationStudy) -> dict[str, Figure]:
    plan = study.plan
    out = {
        f"leg_{limb + 1}": plot_leg(plan, study.run, limb) for limb in range(plan.robot.limb_count)
    }
    out["sag"] = plot_sag(plan, study.run, study.comparison)
    if study.points:
        out["falls"] = plot_falls(study.points, study.sweep_key, plan.name)
    if study.risk is not None and study.risk.falls:
        out["worlds"] = plot_causes(study.risk, plan)
    if isinstance(study.camera, SnapshotCamera) and study.camera.pictures:
        out["climb"] = plot_film_strip(study.camera.strip, plan.trajectory.time.tolist(), plan.name)
    return out


def _format_table(study: SimulationStudy) -> str:
    """Format a table with a row for each standing limb at each instant that was reached."""
    plan, comparison = study.plan, study.comparison
    stream = io.StringIO()
    table = SafeWriter(stream)
    table.writerow(
        ["instant", "time_s", "limb", "torque_planned_Nm", "torque_Nm", "mu_critical_planned",
         "mu_critical", "mu"]
    )  # fmt: skip
    for row, k in enumerate(comparison.instant):
        for limb, name in enumerate(plan.robot.limb_names):
            if plan.instants.contact[k, limb]:
                values = (
                    comparison.torque_planned, comparison.torque, comparison.friction_planned,
                    comparison.friction, comparison.mu,
                )  # fmt: skip
                cells = [f"{v[row, limb]:.6g}" for v in values]
                table.writerow(
                    [int(k), f"{study.run.time[comparison.sample[row]]:.3f}", name, *cells]
                )
    return stream.getvalue()


def _build_point_dict(point: SweepPoint) -> dict[str, Any]:
    low, high = point.fall_share.interval
    return {
        "value": point.value,
        "no_plan": point.no_plan,
        "fallen": point.fall_share.fallen,
        "runs": point.fall_share.runs,
        "share": point.fall_share.value,
        "lower": low,
        "upper": high,
        "trials": [convert_trial(trial) for trial in point.trials],
    }
