"""The report of a stiffness identification: report.json, stiffness.csv and a figure."""

from __future__ import annotations

import io
import json
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from climbplan.mechanics.identification.fit import Estimate, Fit
from climbplan.mechanics.identification.measurements import AXES
from climbplan.mechanics.identification.study import Identification
from climbplan.reports import palette
from climbplan.reports.sheet import (
    draw_foot_legend,
    draw_heading,
    draw_panel_title,
    format_plain,
    new_figure,
    render_png,
    style_axes,
)
from climbplan.robots.serial_chain import SerialChain
from climbplan.store.csv_file import SafeWriter


def draw_stiffness(fit: Fit, name: str) -> Figure:
    """Return eigenvalues of every matrix, and all entries measured against fitted."""
    figure = new_figure(4.2, entries=2)
    left, right = figure.subplots(1, 2, width_ratios=[1.7, 1.0])
    measured = np.array([(m.stiffness + m.stiffness.T) / 2 for m in fit.matrices])
    order = np.argsort(np.linalg.eigvalsh(measured)[:, -1])
    positions = np.arange(len(order))
    eigenvalues = np.linalg.eigvalsh(measured)[order] / 1e3
    fitted = np.linalg.eigvalsh(fit.predicted)[order] / 1e3
    for column in range(eigenvalues.shape[1]):
        dots = left.plot(positions, eigenvalues[:, column], "o", color=palette.FORCE, ms=4.5)[0]
        rings = left.plot(
            positions, fitted[:, column], "o", color=palette.FAILURE, ms=8, mfc="none", mew=1.2
        )[0]
    left.set_yscale("log")
    left.set_xticks(positions, [format_plain(fit.matrices[i].name, 8) for i in order])
    left.set_xlabel("test, by largest eigenvalue")
    left.set_ylabel("eigenvalues [N/mm]")
    draw_panel_title(left, "Principal stiffnesses")
    entries = np.array([m.stiffness for m in fit.matrices]).ravel() / 1e3
    right.axline((0, 0), slope=1.0, color=palette.MUTED, lw=0.8)
    right.plot(entries, fit.predicted.ravel() / 1e3, "o", color=palette.FORCE, ms=4)
    right.set_xlabel("measured entry [N/mm]")
    right.set_ylabel("fitted entry [N/mm]")
    draw_panel_title(right, "Entries", f"median misfit {fit.relative_error:.0%}")
    for ax in (left, right):
        style_axes(ax)
    draw_foot_legend(figure, [dots, rings], ["measured", "joints and structure as fitted"])
    draw_heading(figure, "Stiffness of a limb", format_plain(name))
    return figure


RESULT = "stiffness.csv"


def build_report(identification: Identification, name: str) -> dict[str, Any]:
    """Return what was identified, as JSON-ready values in SI units."""
    reduced, mechanism = identification.reduced, identification.limb.robot.mechanism
    return {
        "name": name,
        "robot": identification.limb.robot.name,
        "limb": identification.limb.robot.limb_names[identification.limb.number],
        "link_lengths": identification.limb.lengths.tolist(),
        "axes": [AXES[a] for a in identification.measurements.axes],
        "matrices": len(identification.matrices),
        "reference_gain": identification.reference_gain,
        "best": _describe_fit(identification, identification.best),
        "models": [_describe_fit(identification, fit) for fit in identification.fits],
        "findings": list(identification.findings),
        "robot_file": identification.robot_file if isinstance(mechanism, SerialChain) else None,
        "skipped": [
            *identification.measurements.skipped,
            *(reduced.skipped if reduced is not None else ()),
            *identification.best.unusable,
        ],
        "tests": [] if reduced is None else _list_slopes(identification),
        "asymmetry": None if reduced is None else float(np.median(reduced.asymmetry)),
        "units": {
            "joint_stiffness.*": "N m/rad",
            **{
                f"joint_stiffness.{name}": "N/m"
                for name in sorted(identification.limb.angles.slides)
            },
            "link_lengths": "m",
            "tests.stiffness": "N/m",
            "tests.published": "N/m",
        },
    }


def write_report(identification: Identification, name: str, directory: Path) -> None:
    """Write report.json, stiffness.csv and figures/stiffness.png into a directory.

    Args:
        identification: The measurements with the models fitted to them.
        name: Name of the measurements, for the report and the figure.
        directory: Directory that exists and has no `figures` yet.
    """
    text = json.dumps(
        build_report(identification, name), indent=2, allow_nan=False, ensure_ascii=False
    )
    (directory / "report.json").write_text(f"{text}\n", encoding="utf-8")
    (directory / RESULT).write_text(_write_table(identification), encoding="utf-8")
    (directory / "figures").mkdir()
    (directory / "figures" / "stiffness.png").write_bytes(
        render_png(draw_stiffness(identification.best, name))
    )


def _format_estimate(value: Estimate) -> dict[str, Any]:
    return {
        "value": value.value,
        "lower": value.lower,
        "upper": value.upper,
        "told": value.is_determined,
    }


def _describe_fit(identification: Identification, fit: Fit) -> dict[str, Any]:
    values = dict(
        zip(identification.limb.felt, map(_format_estimate, fit.joint_stiffness), strict=True)
    )
    return {
        "model": fit.model.name,
        "feet": fit.model.feet,
        "joint_stiffness": values,
        "structural_compliance_share": None if fit.share is None else _format_estimate(fit.share),
        "relative_error": fit.relative_error,
        "cost": fit.cost,
        "degrees_of_freedom": fit.freedom,
        "outliers": list(fit.outliers),
    }


def _list_slopes(identification: Identification) -> list[dict[str, Any]]:
    assert identification.reduced is not None
    axes = identification.measurements.axes
    return [
        {
            "test": slope.series.test,
            "axis": AXES[axes[slope.series.axis]],
            "stiffness": slope.stiffness.tolist(),
            "deviation": slope.deviation.tolist(),
            "published": slope.published.tolist(),
            "bad_rows": list(map(int, slope.bad_rows)),
        }
        for slope in identification.reduced.slopes
    ]


def _write_table(identification: Identification) -> str:
    """Measured and fitted matrices with postures; itself a table that can be read again."""
    axes = identification.measurements.axes
    pairs = [(i, j) for i in range(len(axes)) for j in range(i, len(axes))]
    names = [f"K{AXES[axes[i]]}{AXES[axes[j]]}" for i, j in pairs]
    stream = io.StringIO()
    table = SafeWriter(stream)
    columns = identification.limb.angles
    angles = [f"{joint}_{columns.unit(joint)}" for joint in columns.names]
    scale = [1e3 if joint in columns.slides else 180 / np.pi for joint in columns.names]
    fitted = [f"fitted_{name}_N_per_m" for name in names]
    table.writerow(["test", *angles, *(f"{n}_N_per_m" for n in names), *fitted, "misfit"])
    fit = identification.best
    for row, matrix in enumerate(fit.matrices):
        symmetric_stiffness = (matrix.stiffness + matrix.stiffness.T) / 2
        values = [*(fit.angles[row] * scale), *(symmetric_stiffness[p] for p in pairs)]
        values += [fit.predicted[row][p] for p in pairs]
        table.writerow([matrix.name, *(f"{v:.6g}" for v in values), f"{fit.misfit[row]:.3g}"])
    return stream.getvalue()
