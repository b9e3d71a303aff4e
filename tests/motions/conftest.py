"""A short climb by SiLVIA, one by a robot from a URDF, and what is exported of them."""

from __future__ import annotations

from pathlib import Path

import pytest
from scenes import PlannedScenes

import climbplan
from climbplan.climb.exports.tracked_motion import read_tracked_motion
from climbplan.motions.motion_file import write_motion_file
from climbplan.motions.tracked_motion import TrackedMotion

SPECS = Path(__file__).parents[2] / "specs"
ODD_RATE = 47.0  # [Hz], no divisor of the rate of any plan


@pytest.fixture(scope="session")
def climb(planned_scenes: PlannedScenes) -> Path:
    """Plan file of a climb by a built-in robot."""
    return planned_scenes["climb"]


@pytest.fixture(scope="session")
def motion(climb: Path) -> TrackedMotion:
    """That climb at a rate of its own."""
    return read_tracked_motion(climb, ODD_RATE)


@pytest.fixture(scope="session")
def motion_file(motion: TrackedMotion, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The file of that motion."""
    path = tmp_path_factory.mktemp("motion") / "climb.npz"
    write_motion_file(motion, path)
    return path


@pytest.fixture(scope="session")
def urdf_climb(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Plan file of a climb by a robot from a URDF."""
    pytest.importorskip("pinocchio")
    path = tmp_path_factory.mktemp("urdf_climb") / "plan.h5"
    spec = climbplan.load_spec(
        SPECS / "climb_walker.yaml", overrides={"task.rounds": 1, "task.goal.com": [0, 0, 0.02]}
    )
    climbplan.plan(spec).save(path)
    return path
