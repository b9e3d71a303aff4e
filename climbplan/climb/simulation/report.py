"""A simulated climb or transition told: report.json, table, figures and page."""

from __future__ import annotations

import io
from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from climbplan.climb.simulation.comparison import LEAST_SAG
from climbplan.climb.simulation.figures import falls, leg, sag
from climbplan.climb.simulation.grips.gripping import Gripped
from climbplan.climb.simulation.model.mjcf import TIME_STEP
from climbplan.climb.simulation.risk.figure import first_causes
from climbplan.climb.simulation.risk.judging import judged_dict
from climbplan.climb.simulation.risk.rare import rare_dict
from climbplan.climb.simulation.study import Simulated, WorstWorld, headline
from climbplan.climb.simulation.sweep import SweepPoint
from climbplan.reports.page_parts import Card
from climbplan.simulation.mujoco_loading import load_mujoco
from climbplan.simulation.pictures import Camera
from climbplan.simulation.report_files import (
    WORST_FILM,
    End,
    Told,
    conditions_dict,
    spread,
    strip,
    trial_dict,
)
from climbplan.store.csv_file import SafeWriter

UNITS = {
    "torque.*": "N m", "sag.*": "m", "time": "s", "fall_time": "s", "time_step": "s",
    "worst_world.time": "s",
    "final_offset": "m", "grips.missed": "m", "grips.let_go.time": "s",
    "slips.time": "s", "slips.distance": "m", "lost_contacts.time": "s",
    "lost_contacts.duration": "s", "conditions.payload": "kg",
    "conditions.backlash": "rad", "conditions.armature_value": "kg m^2",
    "conditions.damping_value": "N m s/rad",
}  # fmt: skip


def tell(found: Simulated) -> Told:
    """What stands in the files of a simulated climb."""
    plan = found.plan
    camera = found.camera if isinstance(found.camera, Camera) else None
    film = camera.film() if camera is not None and camera.pictures else None
    return Told(
        title=f"{plan.name}: simulated",
        headline=headline(found),
        end=end_of(found),
        report=report_dict(found),
        table=_table(found),
        figures=_figures(found),
        film=film,
        cards=_cards(found),
        events=_events(found),
        notes=(_MODEL, _JUDGES) if found.run.grips is None else (_MODEL, _GRIPS, _JUDGES),
        worlds="" if found.judged is None else found.judged.stands,
        worst=None if found.worst is None else (_worst_words(found.worst), found.worst.film),
    )


def _worst_words(worst: WorstWorld) -> str:
    return f"World {worst.number}, the worst of those drawn, in MuJoCo: the robot {worst.words}"


def end_of(found: Simulated) -> End:
    """How the nominal run ended; a toe that slides or comes off is not what was planned."""
    run, compared = found.run, found.compared
    fall = float(run.time[-1]) if run.fallen else None
    return End(fall, len(compared.slips), len(compared.losses), allowed=0)


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


def _cards(found: Simulated) -> list[Card]:
    compared = found.compared
    torque, sagged = compared.torque_error, compared.sag_error
    friction = compared.friction[np.isfinite(compared.friction)]
    many = f"{len(compared.instant)} of {found.plan.instants.count} instants reached"
    cards = [
        Card("End", f"falls at {found.run.time[-1]:.1f} s" if found.run.fallen else "no fall", many)
    ]
    if torque.size:
        cards.append(Card("Worst motor's torque", f"{np.median(torque):.1%} off", "median"))
    if friction.size:
        used = f"{friction.max():.2f}"
        planned = f"planned {compared.friction_planned.max():.2f}"
        cards.append(Card("Largest critical friction", used, planned))
    if sagged.size:
        off = 1e3 * float(
            np.nanmedian(np.linalg.norm(compared.sag - compared.sag_predicted, axis=1))
        )
        detail = (
            f"median distance to the static equilibrium; {np.median(sagged):.0%} of its sag where "
            f"that is over a millimetre ({sagged.size} instants)"
        )
        cards.append(Card("Sag", f"{off:.1f} mm off", detail))
    if found.run.grips is not None and found.run.grips.missed.size:
        gone, missed = len(found.run.grips.let_go), found.run.grips.missed.max()
        beside = f"holds at most {1e3 * missed:.0f} mm beside them when they close"
        cards.append(Card("Grips that let go", str(gone) if gone else "none", beside))
    if found.judged is not None:
        low, high = found.judged.interval
        fallen = f"{found.judged.falls} of {len(found.judged.outcomes)}"
        detail = f"{found.judged.engine}, 95 % interval {low:.1%} to {high:.1%}"
        cards.append(Card("Worlds that fall", fallen, detail))
    if found.rare is not None:
        low, high = found.rare.interval
        detail = f"statics, splitting, 95 % interval {low:.1e} to {high:.1e}"
        cards.append(Card("Probability of a fall", f"{found.rare.probability:.1e}", detail))
    return cards


def _events(found: Simulated) -> list[tuple[str, str]]:
    plan, compared = found.plan, found.compared
    names = plan.robot.limb_names
    events = [
        (slip.time, f"{names[slip.limb]} slides, {1e3 * slip.distance:.0f} mm in all")
        for slip in compared.slips
    ] + [
        (lost.time, f"{names[lost.limb]} does not touch for {lost.duration:.1f} s")
        for lost in compared.losses
    ]
    if found.run.grips is not None:
        events += [(x.time, f"{names[x.limb]} {x.words}") for x in found.run.grips.let_go]
    if found.run.fallen:
        events.append((float(found.run.time[-1]), "the robot falls"))
    return [(f"{time:.1f} s", words) for time, words in sorted(events)]


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
        "conditions": conditions_dict(run.conditions),
        "fallen": run.fallen,
        "fell": run.fallen,
        "fall_time": float(run.time[-1]) if run.fallen else None,
        "time": float(run.time[-1]),
        "planned_time": float(plan.trajectory.time[-1]),
        "instants": {"planned": plan.instants.count, "reached": len(compared.instant)},
        "torque": {
            "relative_error": spread(compared.torque_error),
            "least_compared": compared.least_torque,
            "largest": float(np.abs(run.torque).max()),
            "largest_planned": float(np.abs(plan.forces.motor_torques).max()),
        },
        "friction": {
            "critical": spread(compared.friction[compared.friction > 0]),
            "planned": spread(compared.friction_planned[compared.friction_planned > 0]),
            "below_mu": float((compared.friction < compared.mu).mean())
            if compared.friction.size
            else None,
        },
        "sag": {
            "simulated": spread(np.linalg.norm(compared.sag, axis=1)),
            "predicted": spread(np.linalg.norm(compared.sag_predicted[finite], axis=1)),
            "relative_error": spread(compared.sag_error),
            "absolute_error": spread(np.linalg.norm(compared.sag - compared.sag_predicted, axis=1)),
            "compared_above": LEAST_SAG,
            "compared": len(compared.sag_error),
            "lag": spread(np.linalg.norm(compared.lag, axis=1)),
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
        "grips": None if run.grips is None else _grips(run.grips, names),
        "worlds": None if found.judged is None else judged_dict(found.judged, names, plan),
        "worst_world": None if found.worst is None else _worst_world(found.worst),
        "rare": None if found.rare is None else rare_dict(found.rare),
        "runs": [trial_dict(trial) for trial in found.trials],
        "sweep": {
            "key": found.sweep_key,
            "points": [_point(point) for point in found.points],
        },
        "pictures": found.camera if isinstance(found.camera, str) else "figures/climb.png",
        "units": UNITS,
    }


def _worst_world(worst: WorstWorld) -> dict[str, Any]:
    return {
        "world": worst.number,
        "fallen": worst.run.fallen,
        "time": float(worst.run.time[-1]),
        "film": WORST_FILM,
    }


def _grips(grips: Gripped, names: Sequence[str]) -> dict[str, Any]:
    return {
        "closed": int(grips.missed.size),
        "missed": spread(grips.missed),
        "let_go": [{"limb": names[x.limb], "time": x.time, "words": x.words} for x in grips.let_go],
    }


def _figures(found: Simulated) -> dict[str, Figure]:
    plan = found.plan
    out = {f"leg_{limb + 1}": leg(plan, found.run, limb) for limb in range(plan.robot.limb_count)}
    out["sag"] = sag(plan, found.run, found.compared)
    if found.points:
        out["falls"] = falls(found.points, found.sweep_key, plan.name)
    if found.judged is not None and found.judged.falls:
        out["worlds"] = first_causes(found.judged, plan)
    if isinstance(found.camera, Camera) and found.camera.pictures:
        out["climb"] = strip(found.camera.strip, plan.trajectory.time.tolist(), plan.name)
    return out


def _table(found: Simulated) -> str:
    """One row a standing limb at each instant reached."""
    plan, compared = found.plan, found.compared
    stream = io.StringIO()
    table = SafeWriter(stream)
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
        "trials": [trial_dict(trial) for trial in point.trials],
    }
