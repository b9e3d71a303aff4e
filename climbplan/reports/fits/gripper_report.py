"""The report of a gripper model: gripper.json, report.json and a calibration plot."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from matplotlib.figure import Figure

from climbplan.mechanics.gripper import Calibration, ShearMeasurements
from climbplan.mechanics.gripper_model import FORMAT, FORMAT_VERSION, GripperModel
from climbplan.reports import palette
from climbplan.reports.sheet import (
    draw_heading,
    draw_panel_title,
    format_plain,
    new_figure,
    render_png,
    style_axes,
)

RESULT = "gripper.json"
_CONFIDENCE = 0.95


def build_report(
    model: GripperModel, calibration: Calibration, grips: ShearMeasurements, name: str
) -> dict[str, Any]:
    """Return key figures as JSON-ready values, SI units."""
    return {
        "name": name,
        "grips": len(grips.force),
        "signal": model.signal,
        "length": model.length,
        "noise": model.noise,
        "cross_validation": {
            "rmse": calibration.rmse,
            "share_above_95_bound": calibration.share_above(grips, _CONFIDENCE),
            "confidence": calibration.levels.tolist(),
            "share_above": calibration.covered.tolist(),
        },
        "units": {"signal": "N", "noise": "N", "cross_validation.rmse": "N"},
    }


def write_report(
    model: GripperModel,
    calibration: Calibration,
    grips: ShearMeasurements,
    name: str,
    directory: Path,
) -> None:
    """Write gripper.json (plain numbers), report.json and figures/calibration.png."""
    arrays = {
        "format": FORMAT,
        "format_version": FORMAT_VERSION,
        "inputs": ["alpha [rad]", "beta [rad]", "gamma [rad]", "friction"],
        "state": model.state.tolist(),
        "force": model.force.tolist(),
        "center": model.center.tolist(),
        "scale": model.scale.tolist(),
        "signal": model.signal,
        "length": model.length,
        "noise": model.noise,
    }
    (directory / RESULT).write_text(json.dumps(arrays, allow_nan=False), encoding="utf-8")
    report = build_report(model, calibration, grips, name)
    text = json.dumps(report, indent=2, allow_nan=False, ensure_ascii=False)
    (directory / "report.json").write_text(f"{text}\n", encoding="utf-8")
    (directory / "figures").mkdir()
    figure = draw_calibration(calibration, grips, name)
    (directory / "figures" / "calibration.png").write_bytes(render_png(figure))


def draw_calibration(calibration: Calibration, grips: ShearMeasurements, name: str) -> Figure:
    """Return held-out forces against predictions, and how often lower bounds hold."""
    figure = new_figure(4.2, entries=1)
    left, right = figure.subplots(1, 2)
    held_out = calibration.held_out
    left.errorbar(
        held_out.mean,
        grips.force,
        xerr=held_out.deviation,
        fmt="o",
        ms=3,
        lw=0.7,
        color=palette.FORCE,
    )
    left.axline((0, 0), slope=1.0, color=palette.MUTED, lw=0.8)
    left.set_xlabel("predicted shear force [N]")
    left.set_ylabel("measured [N]")
    draw_panel_title(left, "Held-out grips", f"rms error {calibration.rmse:.2f} N")
    right.plot(calibration.levels, calibration.covered, "o-", ms=3, lw=1.0, color=palette.FORCE)
    right.axline((0, 0), slope=1.0, color=palette.MUTED, lw=0.8)
    right.set_xlabel("confidence of the lower bound")
    right.set_ylabel("share of forces above it")
    fraction_above = calibration.share_above(grips, _CONFIDENCE)
    draw_panel_title(right, "Calibration", f"95 % bound: {fraction_above:.1%} above")
    for ax in (left, right):
        style_axes(ax)
    draw_heading(figure, "Shear force of a gripper", format_plain(name))
    return figure
