"""A run in Drake in words and numbers."""

from __future__ import annotations

import csv
import io
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from climbplan.arrays import Array
from climbplan.simulation.drake.comparison import RecordingErrors
from climbplan.simulation.drake.contacts import ContactLog
from climbplan.simulation.drake.exported import ExportedMotion
from climbplan.simulation.drake.planned_penetration import PlannedPenetration
from climbplan.simulation.drake.plant import DISSIPATION, STICTION, STIFFNESS, Plant
from climbplan.simulation.drake.playing import Recording
from climbplan.simulation.drake.settings import Settings

MAX_GRAVITY_DIFFERENCE = 1e-3  # of torque limits, from which it is told


@dataclass(frozen=True)
class ReportedRun:
    """Everything about one run that a report is made of."""

    motion: ExportedMotion
    plant: Plant
    settings: Settings
    recording: Recording
    contacts: ContactLog
    comparison: RecordingErrors
    penetrations: tuple[PlannedPenetration, ...]
    gravity_difference: float  # of exported gravity torques, in torque limits
    ignored_pairs: tuple[str, ...]  # links that overlap at the start
    left_out: tuple[str, ...]  # of the terrain
    mass: float  # planned [kg]
    version: str  # of Drake


def build_report(run: ReportedRun) -> dict[str, Any]:
    """Return the run as plain values for JSON; lengths in mm, angles in degrees, forces in N."""
    recording, compared = run.recording, run.comparison
    worst = int(np.argmax(compared.distance))
    planned = float(run.motion.time[-1] - run.motion.time[0])
    return {
        "engine": {
            "name": "drake",
            "version": run.version,
            "time_step_s": run.settings.time_step,
            "control_period_s": run.settings.control_period,
            "contact": "point contact, discrete solver SAP (lagged)",
            "contact_stiffness_N_m": STIFFNESS,
            "dissipation_s_m": DISSIPATION,
            "stiction_tolerance_m_s": STICTION,
        },
        "plan_name": run.motion.name,
        "robot": run.motion.robot,
        "conditions": asdict(run.settings),
        "fell": recording.fall_time is not None,
        "fall_time": recording.fall_time,
        "fall": recording.fall_words,
        "planned_time": planned,
        "cpu_seconds": recording.cpu_seconds,
        "cpu_seconds_per_second": recording.cpu_seconds / max(recording.time[-1], 1e-9),
        "body": {
            "end_mm": 1e3 * float(compared.distance[-1]),
            "end_deg": float(np.rad2deg(compared.angle[-1])),
            "max_mm": 1e3 * float(compared.distance[worst]),
            "max_mm_time": recording.time[worst],
            "max_deg": float(np.rad2deg(compared.angle.max())),
        },
        "torque": {
            "median_error": _compute_median(compared.torque_error),
            "max_error": _compute_max(compared.torque_error),
            "median_error_all_motors": _compute_median(compared.all_torque_error),
            "share_of_time_at_limit": compared.at_limit,
        },
        "force": {
            "median_error": _compute_median(compared.force_error),
            "max_error": _compute_max(compared.force_error),
        },
        "slips": [asdict(slip) for slip in run.contacts.slips],
        "lost_contacts": [asdict(lost) for lost in run.contacts.lost],
        "link_contacts": [
            asdict(contact)
            for contact in sorted(run.contacts.links.values(), key=lambda c: c.first_time)
        ],
        "planned_penetrations": [asdict(penetration) for penetration in run.penetrations],
        "gravity_torque_difference": run.gravity_difference,
        "mass": {"planned_kg": run.mass, "urdf_kg": run.plant.mass},
        "urdf_warnings": list(run.plant.urdf_warnings),
        "toes_replaced_by_spheres": list(run.plant.added_toes),
        "overlapping_links": list(run.ignored_pairs),
        "terrain_left_out": list(run.left_out),
    }


def summarise_run(report: Mapping[str, Any]) -> str:
    """Return the run in one line."""
    if report["fell"]:
        return f"Drake: falls at {report['fall_time']:.2f} s, {report['fall']}"
    slips, lost = len(report["slips"]), len(report["lost_contacts"])
    return f"Drake: stands, {slips} slips, {lost} lost contacts"


def explain_failure(report: Mapping[str, Any], most_slips: int) -> str:
    """Return why the plan does not hold in Drake, "" if it does.

    most_slips: slips and lost contacts together that are let pass.
    """
    if report["fell"]:
        return f"the robot falls in Drake at {report['fall_time']:.2f} s: {report['fall']}"
    slips, lost = len(report["slips"]), len(report["lost_contacts"])
    if slips + lost > most_slips:
        return (
            f"the robot stands in Drake with {slips} slips and {lost} lost contacts; "
            f"{most_slips} together are let pass (--most-slips)"
        )
    return ""


def format_lines(report: Mapping[str, Any]) -> list[str]:
    """Return the run's numbers for a terminal, a line each."""
    body, torque, force = report["body"], report["torque"], report["force"]
    out = [
        f"body     {body['end_mm']:.1f} mm and {body['end_deg']:.2f} deg off at the end",
        f"         {body['max_mm']:.1f} mm (at {body['max_mm_time']:.1f} s) at most",
        *(
            f"{name:8s} {_format_percent(of['median_error'])} off (median), at most "
            + _format_percent(of["max_error"])
            for name, of in (("torque", torque), ("force", force))
        ),
    ]
    out += [
        f"slip     {s['limb']} at {s['time']:.2f} s, {1e3 * s['distance']:.1f} mm"
        for s in report["slips"]
    ]
    out += [
        f"lost     {c['limb']} at {c['time']:.2f} s for {c['duration']:.2f} s"
        for c in report["lost_contacts"]
    ]
    out += [
        f"touches  {c['link']} touches {c['other']} from {c['first_time']:.2f} s on, for "
        f"{c['seconds']:.2f} s, at most {c['max_force']:.0f} N"
        for c in report["link_contacts"]
    ]
    out += [
        f"planned  {p['link']}{', at its toe,' if p['is_toe'] else ''} is "
        f"{1e3 * p['depth']:.1f} mm inside {p['other']} at {p['time']:.2f} s"
        for p in report["planned_penetrations"]
    ]
    if report["gravity_torque_difference"] > MAX_GRAVITY_DIFFERENCE:
        difference = _format_percent(report["gravity_torque_difference"])
        out.append(f"gravity  exported torques are {difference} of a motor's limit off Drake's")
    mass = report["mass"]
    if abs(mass["planned_kg"] - mass["urdf_kg"]) > 1e-6 * mass["urdf_kg"]:
        out.append(
            f"mass     {mass['planned_kg']:.3f} kg planned, {mass['urdf_kg']:.3f} kg in the URDF: "
            "scaled"
        )
    out += [f"urdf     {line}" for line in sorted(set(report["urdf_warnings"]))]
    for limb in report["toes_replaced_by_spheres"]:
        out.append(f"toe      {limb}: a sphere in place of the link's collision geometry")
    out += [f"ignored  {pair} overlap at the start" for pair in report["overlapping_links"]]
    out += [f"left out {omission}" for omission in report["terrain_left_out"]]
    out.append(f"engine   {report['cpu_seconds_per_second']:.2f} s of CPU a simulated second")
    return out


def format_table(run: ReportedRun) -> str:
    """Return a CSV, one row a recorded sample."""
    stream = io.StringIO()
    writer = csv.writer(stream, lineterminator="\n")
    names = [contact.name for contact in run.motion.contacts]
    compared = run.comparison
    writer.writerow(
        ["time_s", "body_off_mm", "body_off_deg", "torque_error", "force_error"]
        + [f"{joint.name}_{'N' if joint.slides else 'Nm'}" for joint in run.motion.joints]
        + [f"{name}_force_{axis}_N" for name in names for axis in "xyz"]
    )
    for index, time in enumerate(run.recording.time):
        numbers = [
            time,
            1e3 * compared.distance[index],
            np.rad2deg(compared.angle[index]),
            compared.torque_error[index],
            compared.force_error[index],
            *run.recording.torque[index],
            *run.recording.force[index].ravel(),
        ]
        writer.writerow([f"{number:.6g}" if np.isfinite(number) else "" for number in numbers])
    return stream.getvalue()


def _compute_median(values: Array) -> float | None:
    finite_values = values[np.isfinite(values)]
    return float(np.median(finite_values)) if finite_values.size else None


def _compute_max(values: Array) -> float | None:
    finite_values = values[np.isfinite(values)]
    return float(finite_values.max()) if finite_values.size else None


def _format_percent(value: float | None) -> str:
    return "nothing to compare" if value is None else f"{100 * value:.1f} %"
