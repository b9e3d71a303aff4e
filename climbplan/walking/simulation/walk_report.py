"""What is told of every simulated walk: numbers, events, table and film."""

from __future__ import annotations

import io
from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from climbplan.simulation.mujoco_loading import load_mujoco
from climbplan.simulation.pictures import Camera
from climbplan.simulation.report_files import End, conditions_dict, spread, strip, trial_dict
from climbplan.simulation.trials import Trial
from climbplan.store.csv_file import SafeWriter
from climbplan.walking.plan.walk_plan import WalkPlan
from climbplan.walking.simulation.comparison import WalkComparison
from climbplan.walking.simulation.model import TIME_STEP
from climbplan.walking.simulation.replay import WalkRun

UNITS = {
    "path.*": "m", "tilt.*": "rad", "time": "s", "fall_time": "s", "time_step": "s",
    "overreach": "m",
    "force_error.*": "robot weights", "correction.*": "robot weights", "slips.time": "s",
    "slips.distance": "m", "lost_contacts.time": "s", "lost_contacts.duration": "s",
    "conditions.payload": "kg", "conditions.armature_value": "kg m^2",
}  # fmt: skip


def walk_numbers(
    plan: WalkPlan,
    run: WalkRun,
    compared: WalkComparison,
    trials: Sequence[Trial],
    camera: Camera | str,
) -> dict[str, Any]:
    """Key figures as JSON-ready values, SI units (`UNITS`), of a walk whatever its model."""
    names = plan.task.body.leg_names
    return {
        "name": plan.name,
        "spec_sha256": plan.spec_sha256,
        "simulator": f"MuJoCo {load_mujoco().__version__}",
        "time_step": TIME_STEP,
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
        "slips": [
            {"limb": names[s.leg], "time": s.time, "distance": s.amount} for s in compared.slips
        ],
        "lost_contacts": [
            {"limb": names[s.leg], "time": s.time, "duration": s.amount} for s in compared.losses
        ],
        "runs": [trial_dict(trial) for trial in trials],
        "pictures": camera if isinstance(camera, str) else "figures/walk.png",
        "units": UNITS,
    }


def end_of(plan: WalkPlan, run: WalkRun, compared: WalkComparison, joint_speed: float = 0.0) -> End:
    """How the nominal run ended; feet of a trot may land a few hundredths of a second late.

    joint_speed: largest share of a joint's speed limit, 0 of robots without joints.
    """
    fall = float(run.time[-1]) if run.fallen else None
    legs = plan.task.body.leg_count
    return End(fall, len(compared.slips), len(compared.losses), legs, joint_speed)


def filmed(plan: WalkPlan, camera: Camera | str) -> tuple[dict[str, Figure], bytes | None]:
    """Pictures side by side as the figure `walk`, and the film; nothing without pictures."""
    if not isinstance(camera, Camera) or not camera.pictures:
        return {}, None
    times = (plan.task.step * np.arange(plan.task.knots + 1)).tolist()
    return {"walk": strip(camera.strip, times, plan.name)}, camera.film()


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
