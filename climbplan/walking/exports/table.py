"""A walk as CSV for a robot or another simulator."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import TextIO

from climbplan.store.csv_file import write_csv
from climbplan.walking.plan.file import read_walk_plan
from climbplan.walking.plan.walk_plan import WalkPlan

_BODY = (
    *(f"com_{a}_m" for a in "xyz"),
    *(f"velocity_{a}_m_s" for a in "xyz"),
    *(f"{a}_rad" for a in ("roll", "pitch", "yaw")),
    *(f"spin_{a}_rad_s" for a in "xyz"),
)


def export_csv(path: Path, out: Path | TextIO) -> None:
    """Write the samples of a plan file as CSV with one header line that names the units.

    Columns: time, body position, velocity, Euler angles and angular velocity, then for each leg toe
    position, force and contact as 0 or 1 (world frame). Raises PlanFileError for a file that is not
    an MPC plan and UsageError if `out` cannot be written.
    """
    plan = read_walk_plan(path)
    names = plan.task.body.leg_names
    toes = [f"{leg}_toe_{a}_m" for leg in names for a in "xyz"]
    forces = [f"{leg}_force_{a}_N" for leg in names for a in "xyz"]
    header = ["time_s", *_BODY, *toes, *forces, *(f"{leg}_contact" for leg in names)]
    write_csv(out, header, _list_rows(plan))


def _list_rows(plan: WalkPlan) -> Iterator[list[float | int]]:
    """Yield the rows of the table."""
    trajectory = plan.trajectory
    for n in range(plan.task.knots + 1):
        yield [
            plan.task.dt * n,
            *trajectory.state[n].tolist(),
            *trajectory.toes[n].ravel().tolist(),
            *trajectory.force[n].ravel().tolist(),
            *(int(stands) for stands in trajectory.gait.contact[n]),
        ]
