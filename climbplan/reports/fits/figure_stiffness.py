"""Measured stiffness against that of the fitted joints and structure."""

from __future__ import annotations

import numpy as np
from matplotlib.figure import Figure

from climbplan.mechanics.identification.fit import Fit
from climbplan.reports import palette
from climbplan.reports.sheet import foot_legend, heading, new_figure, panel_title, plain, style_axes


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
