"""The motion of a LIMMS plan as CSV for a robot or another simulator."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import TextIO

from climbplan.limms.plan.file import read_limms_plan
from climbplan.limms.plan.limms_plan import LimmsPlan
from climbplan.store.csv_file import write_csv


def export_csv(path: Path, out: Path | TextIO) -> None:
    """Write time, box and joint angles of every sample; times of events occur twice.

    Raises:
        PlanFileError: The plan is damaged.
        UsageError: The output cannot be written.
    """
    plan = read_limms_plan(path)
    head = ["time_s"]
    for b in range(plan.deliveries):
        box = f"box{b}" if b else "box"
        head += [f"{box}_mode", f"{box}_x_m", f"{box}_y_m", f"{box}_z_m"]
    for name in plan.module_names:
        head += [f"{name}_mode", *(f"{name}_joint{j}_rad" for j in range(1, 7))]
    head += [f"box{b}_yaw_rad" if b else "box_yaw_rad" for b in range(plan.deliveries)]
    write_csv(out, head, _iterate_rows(plan))


def _iterate_rows(plan: LimmsPlan) -> Iterator[list[str]]:
    """Yield the rows of the table."""
    motion = plan.motion
    for k in range(len(motion.time)):
        row = [f"{motion.time[k]:.6f}"]
        for b in range(plan.deliveries):
            row.append(str(motion.box_mode[k, b]))
            row += [f"{value:.9g}" for value in motion.box_position[k, b]]
        for m in range(len(plan.module_names)):
            row.append(str(motion.mode[k, m]))
            row += [f"{angle:.9g}" for angle in motion.joint_angles[k, m]]
        row += [f"{yaw:.9g}" for yaw in motion.box_yaw[k, : plan.deliveries]]
        yield row
