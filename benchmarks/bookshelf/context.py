"""Published figures that stand beside ours as context: other machines, solvers and tolerances.

X. Lin, UCLA 2022, Tables 8.1 and 8.2. Averages of the objective are over each method's own
successes and leave out the mean of |x0|^2 over its scenes, which is about 8958 mm^2 (of the
published test set; 105 mm^2 standard error for 400 scenes): costs are shown with it added, so that
differences between columns of nearly full success count, not the figures themselves.
"""

from __future__ import annotations

from dataclasses import dataclass

MEAN_X0 = 8958.0  # [mm^2] mean of |x0|^2 of the published test set
X0_ERROR = 105.0  # [mm^2] standard error for 400 scenes
NOTES = f"""\
published for context, not comparable: solvers as named, Table 8.2 on an Intel i7-7800X; 1.5 mm
between points, 0.05 on sines, piecewise products: the published optima overlap by up to 9.7 mm.
Movement cost: averages over a method's own successes plus {MEAN_X0:.0f} +- {X0_ERROR:.0f} mm^2
(mean |x0|^2, left out there): only differences between rows of nearly full success mean something.
"""


@dataclass(frozen=True)
class PublishedRow:
    """One column of Table 8.1, or row of Table 8.2."""

    table: str
    method: str
    success: float | None  # [%]
    mean_ms: float | None
    max_ms: float | None
    objective: float | None  # [mm^2] as printed, without mean |x0|^2
    tried: float | None  # candidates or iterations

    @property
    def movement(self) -> float | None:
        """Movement cost [mm^2] as near as it can be told."""
        return None if self.objective is None else self.objective + MEAN_X0


ROWS = (
    PublishedRow("8.1", "ADMM, Gurobi and Knitro", 96.5, 260, 1290, -7250, 4.73),
    PublishedRow("8.1", "ADMM, Gurobi and IPOPT", 94.75, 522, 3590, -7339, 4.6),
    PublishedRow("8.1", "MIP, 50 samples a cluster, Gurobi", 100, 790, 17300, -8606, 1),
    PublishedRow("8.1", "MIP, 20 samples a cluster, Gurobi", 98.75, 616, 70000, -8435, 1),
    PublishedRow("8.1", "MPCC, default start, Knitro", 1.25, 72, 82, -5703, None),
    PublishedRow("8.1", "MPCC, default start, IPOPT", 0, None, None, None, None),
    PublishedRow("8.1", "MPCC, manual start, Knitro", 78.25, 29, 198, -8620, 1),
    PublishedRow("8.1", "MPCC, manual start, IPOPT", 78.25, 81, 1960, -8952, 1),
    PublishedRow("8.1", "MPCC, 3 neighbours of 15000, Knitro", 99.25, 30, 280, -8258, 1.05),
    PublishedRow("8.1", "MPCC, 3 neighbours of 15000, IPOPT", 98.5, 96, 990, -8618, 1.06),
    PublishedRow("8.1", "MPCC, worst 3 of 36000, Knitro", 92.5, 61, 327, -6461, 1.25),
    PublishedRow("8.1", "convex, 15000, OSQP 200 iterations", 94.5, 65, 190, -8631, 4.85),
    PublishedRow("8.1", "convex, 15000, OSQP 600 iterations", 98.75, 80, 400, -8687, 3.85),
    PublishedRow("8.1", "convex, 78000, OSQP 200 iterations", 96, 16, 174, -8637, 2.57),
    PublishedRow("8.2", "CoCo + ReDUCE, Gurobi (140 dearer)", 99.2, 1210, 13470, None, None),
    PublishedRow("8.2", "MIP + ReDUCE, Gurobi", 100, 2360, 48000, None, None),
    PublishedRow("8.2", "MIP, Gurobi (over 851 s)", None, 851000, None, None, None),
    PublishedRow("8.2", "MINLP, Bonmin (over 10 min)", None, 600000, None, None, None),
)
