"""The report of an MPC plan: report.json, figures, and the HTML page."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from climbplan.reports.page_parts import Card, format_value, read_part
from climbplan.reports.page_template import (
    build_data_element,
    build_origin_rows,
    build_plan_tables,
    build_report_fields,
    build_run_fields,
    build_verification_fields,
    fill,
)
from climbplan.reports.plan_report import FigureOf, PlanReport
from climbplan.reports.report_files import replace_non_finite
from climbplan.reports.scene_replay import build_scene_replay
from climbplan.verification.verification import Verification
from climbplan.walking.check.checker import LEG_LIMITS, LIMITS, LOOP_LIMITS, SCANNED_LIMITS
from climbplan.walking.check.plan_checks import LIMITS as FILE_LIMITS
from climbplan.walking.check.verification import verify
from climbplan.walking.online.closed_loop import (
    RECOVERY_TOLERANCE,
    compute_mean_velocity,
    has_fallen,
)
from climbplan.walking.pages.scene import build_walk_scene
from climbplan.walking.plan.file import FORMAT, FORMAT_VERSION, read_walk_plan
from climbplan.walking.plan.summary import format_gait
from climbplan.walking.plan.walk_plan import WalkPlan
from climbplan.walking.task.task import ANGLES, VELOCITY

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_LOOP_NOTE = (
    " About the first push their numbers are the lengths of steps, red ones lead backward; the "
    "strip below the speed tells what each tick took: the plan of the tick before, a neighbour in "
    "the library, a gait by name, or where none holds a safe stance."
)
FIGURES: Mapping[str, Callable[[WalkPlan], Figure]] = {
    "tracking": FigureOf("climbplan.walking.pages.figure_walk:plot_tracking"),
    "gait": FigureOf("climbplan.walking.pages.figure_walk:plot_gait"),
    "snapshots": FigureOf("climbplan.walking.pages.figure_walk:plot_snapshots"),
}


def select_figures(plan: WalkPlan) -> Mapping[str, Callable[[WalkPlan], Figure]]:
    """Return the figures of a plan, with convergence of a bound or pushes of a loop."""
    if plan.loop is not None:
        return {**FIGURES, "gait": FigureOf("climbplan.walking.pages.figure_loop:plot_loop_gait")}
    bounded = any(np.isfinite(step.bound) for step in plan.history)
    if not bounded:
        return FIGURES
    return {
        **FIGURES,
        "convergence": FigureOf("climbplan.walking.pages.figure_walk:plot_convergence"),
    }


def _collect_values(plan: WalkPlan, verification: Verification) -> dict[str, Any]:
    """Collect root attributes, checks, times, sizes, tracking, gait and ticks for report.json."""
    report = {
        "format": FORMAT,
        "format_version": FORMAT_VERSION,
        "climbplan_version": plan.climbplan_version,
        "created": plan.created,
        "name": plan.name,
        "title": plan.title,
        "method": plan.method,
        "integrator": plan.task.integrator,
        "spec": plan.spec_text,
        "spec_sha256": plan.spec_sha256,
        "seed": plan.seed,
        "status": plan.status,
        "verified": verification.passed,
        **verification.scope(),
        "objective": plan.objective,
        "bound": plan.bound,
        "gap": plan.gap,
        "terms": dict(plan.terms),
        "timings": plan.timings,
        "solvers": plan.solvers,
        "sizes": plan.sizes,
        "verification": [check.as_dict() for check in verification.checks],
        "warnings": list(plan.warnings),
        "notes": list(plan.notes),
        "tracking": _measure_tracking(plan),
        "gait": {
            "standing": format_gait(plan.trajectory.gait.contact[:: _samples_per_knot(plan)]),
            "contact": plan.trajectory.gait.contact[: -1 : _samples_per_knot(plan)]
            .astype(int)
            .tolist(),
        },
        "online": _summarise_loop(plan),
        "history": [vars(step) for step in plan.history],
        "figures": [f"figures/{name}.png" for name in select_figures(plan)],
        "units": {"velocity": "m/s", "attitude": "rad", "force": "N", "history.seconds": "s"},
    }
    checked: dict[str, Any] = replace_non_finite(report)
    return checked


def _samples_per_knot(plan: WalkPlan) -> int:
    """Return the samples in a knot."""
    return 1 if plan.loop is None else plan.loop.samples


def _summarise_loop(plan: WalkPlan) -> dict[str, Any] | None:
    """Return times, sources and warnings of the ticks."""
    if plan.loop is None:
        return None
    loop = plan.loop
    # A tick begins where its times change: at knots, and between them after a push
    changes = np.diff(loop.tick_time[:-1]) != 0
    tick_samples = np.flatnonzero(np.concatenate([[True], changes]))
    winner, times = loop.winner[tick_samples], loop.tick_time[tick_samples]
    velocity_error = (
        compute_mean_velocity(plan.trajectory, plan.task.dt) - plan.task.reference.velocity[-1]
    )
    return {
        "ticks": len(winner),
        "ended": _describe_end(plan, float(np.hypot(*velocity_error[:2]))),
        "off_at_end": float(np.hypot(*velocity_error[:2])),
        "tick_time": {
            "median": float(np.median(times)),
            "most99": float(np.percentile(times, 99)),
            "largest": float(times.max()),
        },
        "solve_time_median": float(np.median(loop.solve_time[tick_samples])),
        "candidates_mean": float(loop.candidates_tried[tick_samples].mean()),
        "winners": {
            "plan before": int((winner == -1).sum()),
            "neighbours": int((winner >= 0).sum()),
            "named gaits": int((winner == -2).sum()),
            "safe stance": int((winner == -3).sum()),
            "plan kept": int((winner == -4).sum()),
        },
        "pushes": [
            {"time": float(plan.task.dt * n), "velocity": loop.push[n].tolist()}
            for n in np.flatnonzero(loop.push.any(axis=1))
        ],
        "warnings": list(loop.warnings),
    }


def _describe_end(plan: WalkPlan, off: float) -> str:
    """Return how a closed loop ended, by its own samples."""
    if has_fallen(plan.task.body, plan.trajectory.state[-1], plan.trajectory.toes[-1]):
        return "fell"
    if plan.status == "limit":
        return "cut short"
    return "recovered" if off < RECOVERY_TOLERANCE else "not recovered"


def _measure_tracking(plan: WalkPlan) -> dict[str, Any]:
    """Return deviations from the references, over the horizon and at its end."""
    state, reference = plan.trajectory.state[1:], plan.task.reference
    velocity = np.linalg.norm(state[:, VELOCITY] - reference.velocity, axis=1)
    attitude = np.abs(state[:, ANGLES] - reference.euler).max(axis=1)
    height = np.abs(state[:, 2] - reference.height)
    return {
        name: {"mean": float(off.mean()), "end": float(off[-1])}
        for name, off in (("velocity", velocity), ("attitude", attitude), ("height", height))
    }


def _render_page(plan: WalkPlan, report: Mapping[str, Any], images: Mapping[str, bytes]) -> str:
    """Return the HTML page."""
    meanings = {
        name: limit.meaning
        for name, limit in (
            LIMITS | LEG_LIMITS | SCANNED_LIMITS | LOOP_LIMITS | FILE_LIMITS
        ).items()
    }
    origin = build_origin_rows(
        report, {"Method": report["method"], "Integrator": report["integrator"]}
    )
    history = report["history"][-12:]
    return fill(
        "walking.html",
        **build_report_fields(
            report,
            "mpc",
            _build_cards(report),
            images,
            report["status"],
            scripts=(read_part("replay.js"),),
            data=build_data_element("replay-data", build_scene_replay(build_walk_scene(plan))),
        ),
        **build_verification_fields(report, meanings),
        **build_run_fields(report, build_plan_tables(report, origin)),
        loop_note=_LOOP_NOTE if plan.loop is not None else "",
        terms=[(k, f"{v:.4g}") for k, v in report["terms"].items()],
        history=[(f"{h['seconds']:.2f} s", f"{h['objective']:.5g}") for h in history],
    )


def _build_cards(report: Mapping[str, Any]) -> Iterator[Card]:
    """Yield the cards of the page."""
    gap = f"gap {100 * report['gap']:.1f} %" if report["gap"] is not None else "no bound"
    yield Card("Objective", f"{report['objective']:.4g}", gap)
    tracked = report["tracking"]
    for name, unit in (("velocity", "m/s"), ("attitude", "rad"), ("height", "m")):
        end = f"{tracked[name]['end']:.2g} {unit}"
        yield Card(f"Off in {name}", end, f"at the end; mean {tracked[name]['mean']:.2g} {unit}")
    if report["online"] is not None:
        tick = report["online"]["tick_time"]
        percentile = f"99 % {1e3 * tick['most99']:.2f} ms"
        yield Card("Tick", f"{1e3 * tick['median']:.2f} ms", percentile)
        sources = report["online"]["winners"]
        yield Card("Ticks", str(report["online"]["ticks"]), format_value(sources))
        off = f"{report['online']['off_at_end']:.2f} m/s off over its last 0.48 s"
        yield Card("Walk", report["online"]["ended"], off)
        return
    yield Card("Standing legs", report["gait"]["standing"], "interval by interval")
    yield Card(
        "Time", f"{report['timings']['method']:.2f} s", f"{report['sizes']['gaits tried']} gaits"
    )


_REPORT = PlanReport(read_walk_plan, verify, _collect_values, select_figures, _render_page)
build_report = _REPORT.build_report
write_report = _REPORT.write_report
write_values = _REPORT.write_values
