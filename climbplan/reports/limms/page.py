"""The HTML page of a LIMMS plan: one file with an animated replay that needs nothing else."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np

from climbplan.limms.check.limits import LIMITS, MASS_LIMITS
from climbplan.limms.plan import BOX_MODES, MODULE_MODES, LimmsPlan
from climbplan.limms.scene import ground_patches
from climbplan.reports import palette
from climbplan.reports.page_parts import Card, Table, read_part
from climbplan.reports.page_template import (
    data_element,
    fill,
    origin_rows,
    plan_tables,
    report_fields,
    run_fields,
    verification_fields,
)
from climbplan.reports.replay import key_frames
from climbplan.spec.kinds import validate
from climbplan.spec.limms.model import LimmsSpec
from climbplan.spec.limms.space import free_blocks
from climbplan.spec.yaml_source import parse_yaml

_TOLERANCE = 2e-3  # [m] by which the replay may be off between its frames


def build_page(plan: LimmsPlan, report: Mapping[str, Any], images: Mapping[str, bytes]) -> str:
    """The page as text.

    report: as `report_dict` gives it. images: PNG files by name.
    """
    limits = report["limits"]
    origin = origin_rows(report, {"Method": report["method"], "Modes": report["sequence"]})
    return fill(
        "limms.html",
        **report_fields(
            report,
            "limms",
            _cards(report),
            images,
            report["status"],
            (read_part("limms.js"),),
            data_element("replay-data", _replay(plan)),
        ),
        **verification_fields(
            report, {name: limit.meaning for name, limit in (LIMITS | MASS_LIMITS).items()}
        ),
        **run_fields(report, plan_tables(report, origin)),
        stages=Table.of(
            ("Stage", "From [s]", "To [s]"),
            ((s["name"], f"{s['begin']:.2f}", f"{s['end']:.2f}") for s in report["stages"]),
        ),
        loads=Table.of(
            ("Module", "Force [N]", "Torque [N m]", "Modes"),
            (
                (m["name"], f"{m['force']:.1f}", f"{m['torque']:.1f}", _modes(m["modes"]))
                for m in report["modules"]
            ),
        ),
        loads_note=(
            f"Largest values from the box's forces alone; limits {limits['force']:.0f} N and "
            f"{limits['torque']:.0f} N m. Held level, straight, a module needs "
            f"{limits['own_weight_torque']:.1f} N m for itself. What box and modules ask for "
            "together stands under the checks that begin with load."
        ),
    )


def _cards(report: Mapping[str, Any]) -> Iterator[Card]:
    box = report["box"]
    yield Card("Box", f"{box['mass']:g} kg", f"{1e3 * report['objective']:.2f} mm off its goal")
    yield Card("Motion", f"{report['duration']:.1f} s", f"arrives at {box['final_speed']:.2f} m/s")
    yield Card("Modes of the box", " → ".join(name for name, _ in box["modes"]))
    yield Card(
        "Planned in",
        f"{report['timings']['total']:.1f} s",
        f"{report['sizes']['programs']} programs",
    )
    force = max(m["force"] for m in report["modules"])
    yield Card("Largest force", f"{force:.1f} N", f"limit {report['limits']['force']:.0f} N")


def _modes(story: Sequence[tuple[str, float]]) -> str:
    """Modes with their durations, in order."""
    return ", ".join(f"{name} {seconds:.1f} s" for name, seconds in story)


def _replay(plan: LimmsPlan) -> dict[str, object]:
    """Frames and scene as JSON-ready values, rounded to 0.1 mm."""
    motion = plan.motion
    count = len(motion.time)
    values = np.column_stack([motion.box_position[:, 0], motion.joint_position.reshape(count, -1)])
    forced = np.zeros(count, bool)
    events = np.flatnonzero(np.diff(motion.time) <= 0)
    forced[events] = forced[events + 1] = True
    frames = key_frames(motion.time, values, forced, _TOLERANCE)
    spec, _ = validate(parse_yaml(plan.spec_text, "spec"), LimmsSpec)
    regions = free_blocks([(r.lower, r.upper) for r in spec.terrain.regions]) if spec else []
    free = np.array(regions, float).reshape(-1, 2, 3)
    ground = ground_patches(free, plan.solids) if len(free) else ()
    half = plan.box_size / 2
    fixed = motion.anchor_position[0, 4 * len(plan.box_size) :]
    everything = np.vstack([motion.joint_position.reshape(-1, 3), plan.goal, fixed])
    return {
        "time": motion.time[frames].round(4).tolist(),
        "box": motion.box_position[frames, 0].round(4).tolist(),
        "joints": motion.joint_position[frames].round(4).tolist(),
        "boxMode": motion.box_mode[frames, 0].tolist(),
        "mode": motion.mode[frames].tolist(),
        "boxModes": {str(k): v for k, v in BOX_MODES.items()},
        "modes": {str(k): v for k, v in MODULE_MODES.items()},
        "names": list(plan.module_names),
        "colors": [palette.limb_color(m) for m in range(len(plan.module_names))],
        "radius": plan.module["radius"],
        "size": plan.box_size[0].tolist(),
        "goal": plan.goal[0].tolist(),
        "anchors": fixed.round(4).tolist(),
        "parked": [
            [(c - h).tolist(), (c + h).tolist()]
            for c, h in zip(motion.box_position[0, 1:], half[1:], strict=True)
        ],
        "regions": free.tolist(),
        "ground": [[[*p.lower.tolist(), p.height], [*p.upper.tolist(), p.height]] for p in ground],
        "stages": [list(stage) for stage in plan.stages],
        "lower": everything.min(axis=0).tolist(),
        "upper": everything.max(axis=0).tolist(),
    }
