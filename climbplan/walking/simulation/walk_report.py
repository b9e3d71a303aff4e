"""Parts that reports of all simulated walks share: figures, events, table and film."""

from __future__ import annotations

import io
from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from climbplan.simulation.mujoco_loading import load_mujoco
from climbplan.simulation.pictures import SnapshotCamera
from climbplan.simulation.report_files import (
    SimulationEnd,
    convert_conditions,
    convert_trial,
    plot_film_strip,
    summarise_values,
)
from climbplan.simulation.trials import RandomRun
from climbplan.store.csv_file import SafeWriter
from climbplan.walking.plan.walk_plan import WalkPlan
from climbplan.walking.simulation.comparison import WalkComparison
from climbplan.walking.simulation.mujoco_model import TIME_STEP
from climbplan.walking.simulation.replay import WalkRun

UNITS = {
    "path.*": "m", "tilt.*": "rad", "time": "s", "fall_time": "s", "time_step": "s",
    "overreach": "m",
    "force_error.*": "robot weights", "correction.*": "robot weights", "slips.time": "s",
    "slips.distance": "m", "lost_contacts.time": "s", "lost_contacts.duration": "s",
    "conditions.payload": "kg", "conditions.armature_value": "kg m^2",
}  # fmt: skip


def compute_key_figures(
    plan: WalkPlan,
    run: WalkRun,
    compared: WalkComparison,
    trials: Sequence[RandomRun],
    camera: SnapshotCamera | str,
) -> dict[str, Any]:
    """Return the key figures of a walk as JSON-ready values, SI units (`UNITS`).

    Args:
        plan: the walk.
        run: its simulation, with any model.
        compared: comparison of both.
        trials: random trials.
        camera: the camera, or why there are no pictures.
    """
    names = plan.task.body.leg_names
    return {
        "name": plan.name,
        "spec_sha256": plan.spec_sha256,
        "simulator": f"MuJoCo {load_mujoco().__version__}",
        "time_step": TIME_STEP,
        "integrator": plan.task.integrator,
        "conditions": convert_conditions(run.conditions),
        "fallen": run.fallen,
        "fell": run.fallen,
        "fall_time": float(run.time[-1]) if run.fallen else None,
        "time": float(run.time[-1]),
        "planned_time": plan.task.dt * plan.task.knots,
        "path": summarise_values(compared.position_error),
        "tilt": summarise_values(compared.tilt),
        "force_error": summarise_values(compared.force_error),
        "correction": summarise_values(compared.correction),
        "overreach": compared.overreach,
        "slips": [
            {"limb": names[s.leg], "time": s.time, "distance": s.amount} for s in compared.slips
        ],
        "lost_contacts": [
            {"limb": names[s.leg], "time": s.time, "duration": s.amount} for s in compared.losses
        ],
        "runs": [convert_trial(trial) for trial in trials],
        "pictures": camera if isinstance(camera, str) else "figures/walk.png",
        "units": UNITS,
    }


def build_end(
    plan: WalkPlan, run: WalkRun, compared: WalkComparison, joint_speed: float = 0.0
) -> SimulationEnd:
    """Return how the nominal run ended.

    The feet of a trot may land a few hundredths of a second late. joint_speed: largest fraction of
    a joint's speed limit, 0 for robots without joints.
    """
    fall = float(run.time[-1]) if run.fallen else None
    legs = plan.task.body.leg_count
    return SimulationEnd(
        fall, len(compared.slips), len(compared.losses), legs, joint_speed=joint_speed
    )


def render_pictures(
    plan: WalkPlan, camera: SnapshotCamera | str
) -> tuple[dict[str, Figure], bytes | None]:
    """Render pictures as the figure `walk`, and the film; nothing without pictures."""
    if not isinstance(camera, SnapshotCamera) or not camera.pictures:
        return {}, None
    times = (plan.task.dt * np.arange(plan.task.knots + 1)).tolist()
    return {"walk": plot_film_strip(camera.strip, times, plan.name)}, camera.film()


def list_contact_events(
    plan: WalkPlan, run: WalkRun, compared: WalkComparison
) -> list[tuple[str, str]]:
    """List slips, lost contacts and the fall with their times."""
    names = plan.task.body.leg_names
    events = [
        (s.time, f"{names[s.leg]} slides, {1e3 * s.amount:.0f} mm in all") for s in compared.slips
    ] + [
        (s.time, f"{names[s.leg]} does not touch for {1e3 * s.amount:.0f} ms")
        for s in compared.losses
    ]
    if run.fallen:
        events.append((float(run.time[-1]), "the robot falls"))
    return [(f"{time:.2f} s", text) for time, text in sorted(events)]


def write_contact_table(plan: WalkPlan, run: WalkRun, compared: WalkComparison) -> str:
    """Write a CSV table with one row for each loaded leg and sample."""
    stream = io.StringIO()
    table = SafeWriter(stream)
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
