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
    foot_legend,
    heading,
    new_figure,
    panel_title,
    plain,
    png,
    style_axes,
)
from climbplan.robots.serial_chain import SerialChain
from climbplan.store.csv_file import SafeWriter


def stiffness(fit: Fit, name: str) -> Figure:
    """Eigenvalues of every matrix, and all entries measured against fitted."""
    figure = new_figure(4.2, entries=2)
    left, right = figure.subplots(1, 2, width_ratios=[1.7, 1.0])
    measured = np.array([(m.stiffness + m.stiffness.T) / 2 for m in fit.matrices])
    order = np.argsort(np.linalg.eigvalsh(measured)[:, -1])
    at = np.arange(len(order))
    own = np.linalg.eigvalsh(measured)[order] / 1e3
    fitted = np.linalg.eigvalsh(fit.predicted)[order] / 1e3
    for column in range(own.shape[1]):
        dots = left.plot(at, own[:, column], "o", color=palette.FORCE, ms=4.5)[0]
        rings = left.plot(
            at, fitted[:, column], "o", color=palette.FAILURE, ms=8, mfc="none", mew=1.2
        )[0]
    left.set_yscale("log")
    left.set_xticks(at, [plain(fit.matrices[i].name, 8) for i in order])
    left.set_xlabel("test, by largest eigenvalue")
    left.set_ylabel("eigenvalues [N/mm]")
    panel_title(left, "Principal stiffnesses")
    entries = np.array([m.stiffness for m in fit.matrices]).ravel() / 1e3
    right.axline((0, 0), slope=1.0, color=palette.MUTED, lw=0.8)
    right.plot(entries, fit.predicted.ravel() / 1e3, "o", color=palette.FORCE, ms=4)
    right.set_xlabel("measured entry [N/mm]")
    right.set_ylabel("fitted entry [N/mm]")
    panel_title(right, "Entries", f"median misfit {fit.relative_error:.0%}")
    for ax in (left, right):
        style_axes(ax)
    foot_legend(figure, [dots, rings], ["measured", "joints and structure as fitted"])
    heading(figure, "Stiffness of a limb", plain(name))
    return figure


RESULT = "stiffness.csv"


def report_dict(found: Identification, name: str) -> dict[str, Any]:
    """What was identified, as JSON-ready values in SI units."""
    reduced, mechanism = found.reduced, found.limb.robot.mechanism
    return {
        "name": name,
        "robot": found.limb.robot.name,
        "limb": found.limb.robot.limb_names[found.limb.number],
        "link_lengths": found.limb.lengths.tolist(),
        "axes": [AXES[a] for a in found.measurements.axes],
        "matrices": len(found.matrices),
        "reference_gain": found.reference_gain,
        "best": _fit(found, found.best),
        "models": [_fit(found, fit) for fit in found.fits],
        "findings": list(found.findings),
        "robot_file": found.robot_file if isinstance(mechanism, SerialChain) else None,
        "skipped": [
            *found.measurements.skipped,
            *(reduced.skipped if reduced is not None else ()),
            *found.best.unusable,
        ],
        "tests": [] if reduced is None else _slopes(found),
        "asymmetry": None if reduced is None else float(np.median(reduced.asymmetry)),
        "units": {
            "joint_stiffness.*": "N m/rad",
            **{f"joint_stiffness.{name}": "N/m" for name in sorted(found.limb.angles.slides)},
            "link_lengths": "m",
            "tests.stiffness": "N/m",
            "tests.published": "N/m",
        },
    }


def write_report(found: Identification, name: str, directory: Path) -> None:
    """Write report.json, stiffness.csv and figures/stiffness.png into a directory."""
    text = json.dumps(report_dict(found, name), indent=2, allow_nan=False, ensure_ascii=False)
    (directory / "report.json").write_text(f"{text}\n", encoding="utf-8")
    (directory / RESULT).write_text(_table(found), encoding="utf-8")
    (directory / "figures").mkdir()
    (directory / "figures" / "stiffness.png").write_bytes(png(stiffness(found.best, name)))


def _estimate(value: Estimate) -> dict[str, Any]:
    return {
        "value": value.value,
        "lower": value.lower,
        "upper": value.upper,
        "told": value.is_determined,
    }


def _fit(found: Identification, fit: Fit) -> dict[str, Any]:
    values = dict(zip(found.limb.felt, map(_estimate, fit.joint_stiffness), strict=True))
    return {
        "model": fit.model.name,
        "feet": fit.model.feet,
        "joint_stiffness": values,
        "structural_compliance_share": None if fit.share is None else _estimate(fit.share),
        "relative_error": fit.relative_error,
        "cost": fit.cost,
        "degrees_of_freedom": fit.freedom,
        "outliers": list(fit.outliers),
    }


def _slopes(found: Identification) -> list[dict[str, Any]]:
    assert found.reduced is not None
    axes = found.measurements.axes
    return [
        {
            "test": one.series.test,
            "axis": AXES[axes[one.series.axis]],
            "stiffness": one.stiffness.tolist(),
            "deviation": one.deviation.tolist(),
            "published": one.published.tolist(),
            "bad_rows": list(map(int, one.bad_rows)),
        }
        for one in found.reduced.slopes
    ]


def _table(found: Identification) -> str:
    """Measured and fitted matrices with postures; itself a table that can be read again."""
    axes = found.measurements.axes
    pairs = [(i, j) for i in range(len(axes)) for j in range(i, len(axes))]
    names = [f"K{AXES[axes[i]]}{AXES[axes[j]]}" for i, j in pairs]
    stream = io.StringIO()
    table = SafeWriter(stream)
    columns = found.limb.angles
    angles = [f"{joint}_{columns.unit(joint)}" for joint in columns.names]
    scale = [1e3 if joint in columns.slides else 180 / np.pi for joint in columns.names]
    fitted = [f"fitted_{name}_N_per_m" for name in names]
    table.writerow(["test", *angles, *(f"{n}_N_per_m" for n in names), *fitted, "misfit"])
    fit = found.best
    for row, matrix in enumerate(fit.matrices):
        even = (matrix.stiffness + matrix.stiffness.T) / 2
        values = [*(fit.angles[row] * scale), *(even[p] for p in pairs)]
        values += [fit.predicted[row][p] for p in pairs]
        table.writerow([matrix.name, *(f"{v:.6g}" for v in values), f"{fit.misfit[row]:.3g}"])
    return stream.getvalue()
