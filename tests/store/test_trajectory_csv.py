"""The exported motion is the stored one, to the last bit."""

from __future__ import annotations

import csv
import io
import os
from pathlib import Path

import numpy as np
import pytest
from example_climb import Climb

from climbplan.climb.exports.table import export_csv
from climbplan.errors import PlanFileError, UsageError


def test_every_number_survives(climb: Climb, original: Path, tmp_path: Path) -> None:
    out = tmp_path / "motion.csv"
    export_csv(original, out)
    header, *rows = csv.reader(out.read_text().splitlines())
    assert header[:7] == [
        "time_s",
        "com_x_m",
        "com_y_m",
        "com_z_m",
        "roll_rad",
        "pitch_rad",
        "yaw_rad",
    ]
    assert header[7:10] == ["RF_coxa_rad", "RF_femur_rad", "RF_tibia_rad"]
    assert header[25:31] == [f"{limb}_contact" for limb in ("RF", "RM", "RR", "LR", "LM", "LF")]
    assert header[31] == "RF_coxa_torque_Nm"
    assert header[49] == "RF_coxa_gravity_Nm"
    assert header[-1] == "LF_force_z_N"
    table = np.array(rows, float)
    motion = climb.plan.trajectory
    assert np.array_equal(table[:, 0], motion.time)
    assert np.array_equal(table[:, 1:4], motion.com)
    assert np.array_equal(table[:, 4:7], motion.rpy)
    assert np.array_equal(table[:, 7:25].reshape(-1, 6, 3), motion.joint_command)
    assert np.array_equal(table[:, 25:31].astype(bool), motion.contact)
    assert set(np.unique([row[25:31] for row in rows])) == {"0", "1"}


def test_a_stream_gets_the_same(original: Path, tmp_path: Path) -> None:
    stream = io.StringIO()
    export_csv(original, stream)
    export_csv(original, tmp_path / "motion.csv")
    assert stream.getvalue() == (tmp_path / "motion.csv").read_bytes().decode()


def test_nothing_half_written(original: Path, tmp_path: Path) -> None:
    (tmp_path / "motion.csv").write_text("old")
    (tmp_path / "plan.h5").write_text("not a plan")
    with pytest.raises(PlanFileError):
        export_csv(tmp_path / "plan.h5", tmp_path / "motion.csv")
    assert (tmp_path / "motion.csv").read_text() == "old"
    with pytest.raises(UsageError, match="cannot be written: No such file"):
        export_csv(original, tmp_path / "nowhere" / "motion.csv")
    with pytest.raises(UsageError, match="it is a directory"):
        export_csv(original, tmp_path)
    assert sorted(os.listdir(tmp_path)) == ["motion.csv", "plan.h5"]
