"""Public motions of the benchmark: poses of the root and joints give all links."""

from __future__ import annotations

import io
import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from benchmarks.motions.public import PublicSource, list_files, read_public_motion, read_sources
from climbplan.climb.exports.tracked_motion import read_tracked_motion
from climbplan.errors import SpecError, UsageError
from climbplan.motions.completion import read_robot
from climbplan.motions.tracked_motion import TrackedMotion

URDF = Path(__file__).parents[2] / "specs" / "walker.urdf"
LIST = f"""\
sources:
  - name: between walls
    source: example.org/motions
    commit: "0"
    files: "*.csv"
    fps: 50
    robot: {URDF}
    feet: [R1_toe]
"""


@pytest.fixture(scope="module")
def climb_motion(urdf_climb: Path) -> TrackedMotion:
    return read_tracked_motion(urdf_climb, 50.0)


def list_rows(motion: TrackedMotion, joints: list[str]) -> list[list[float]]:
    """Return position and quaternion x, y, z, w of the root, and joints in an order."""
    columns = [motion.joint_names.index(name) for name in joints]
    quaternion = motion.body_quaternion[:, 0][:, [1, 2, 3, 0]]
    rows = np.hstack([motion.body_position[:, 0], quaternion, motion.joint_position[:, columns]])
    return [[float(value) for value in row] for row in rows]


@pytest.mark.parametrize("kind", ["csv", "frames"])
def test_links_and_velocities_are_those_of_the_motion(
    climb_motion: TrackedMotion, tmp_path: Path, kind: str
) -> None:
    joints = sorted(climb_motion.joint_names)
    rows = list_rows(climb_motion, joints)
    path = tmp_path / "climb.csv"
    if kind == "csv":
        np.savetxt(path, rows, delimiter=",")
    else:
        path.write_text(json.dumps({"FrameDuration": 0.02, "Frames": rows}))
    (tmp_path / "sources.yaml").write_text(LIST)
    (source,) = read_sources(tmp_path / "sources.yaml")
    source = source.model_copy(update={"joints": tuple(joints), "format": kind})
    assert list_files(source, tmp_path) == [path]
    motion = read_public_motion(path, source, read_robot(URDF))
    assert motion.fps == pytest.approx(50)
    order = [climb_motion.body_names.index(name) for name in motion.body_names]
    np.testing.assert_allclose(
        motion.body_position, climb_motion.body_position[:, order], atol=1e-5
    )
    speed = np.abs(climb_motion.body_angular_velocity).max()
    difference = motion.body_angular_velocity - climb_motion.body_angular_velocity[:, order]
    assert np.sqrt((difference**2).mean()) < 0.1 * speed


def test_what_is_no_motion_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "sources.yaml"
    path.write_text(LIST.replace("commit", "comit"))
    with pytest.raises(SpecError, match="commit"):
        read_sources(path)
    path.write_text(LIST)
    (source,) = read_sources(path)
    with pytest.raises(UsageError, match="no files"):
        list_files(source, tmp_path)
    (tmp_path / "short.csv").write_text("0,0,0,0,0,0,1\n0,0,0,0,0,0,1\n")
    with pytest.raises(UsageError, match="expected samples of"):
        read_public_motion(tmp_path / "short.csv", source, read_robot(URDF))
    (tmp_path / "words.csv").write_text("a,b\n")
    with pytest.raises(UsageError, match=r"words\.csv"):
        read_public_motion(tmp_path / "words.csv", source, read_robot(URDF))
    frames: PublicSource = source.model_copy(update={"format": "frames"})
    (tmp_path / "frames.txt").write_text("{}")
    with pytest.raises(UsageError, match=r"frames\.txt"):
        read_public_motion(tmp_path / "frames.txt", frames, read_robot(URDF))


@pytest.mark.merge
def test_simulated_feet_slide_and_sink_little(urdf_climb: Path) -> None:
    pytest.importorskip("mujoco")
    from benchmarks.motions.simulated import bench_simulated, measure_penetration
    from climbplan.climb.plan.file import read_climb
    from climbplan.climb.simulation.comparison import find_slips, list_slides
    from climbplan.climb.simulation.replay import simulate
    from climbplan.simulation.conditions import NOMINAL

    out = io.StringIO()
    results = bench_simulated([urdf_climb], out)
    assert results["motions"] == results["stand"] == 1
    assert "1 of them in MuJoCo, 1 stand" in out.getvalue()
    assert 0 < results["slip"][-1] < 5e-3
    assert results["penetration"][-1] < 2e-3
    plan = read_climb(urdf_climb)
    run = simulate(plan, NOMINAL)
    # A toe that is moved along its wall in the middle of a stance has slid, and one that is moved
    # into the wall is that much deeper
    slide = max(list_slides(plan, run), key=lambda s: len(s.distance))
    sample = slide.start + len(slide.distance) // 2
    moved = run.toes.copy()
    moved[sample, slide.limb, 2] += 0.02
    (slip,) = find_slips(plan, replace(run, toes=moved))
    assert (slip.limb, slip.time) == (slide.limb, run.time[sample])
    assert slip.distance == pytest.approx(0.02, abs=5e-3)
    normal = plan.instants.normal[0, slide.limb]
    moved = run.toes.copy()
    moved[sample, slide.limb] -= 0.01 * normal
    sunk = measure_penetration(plan, replace(run, toes=moved))
    assert sunk == pytest.approx(0.01, abs=2e-3)
