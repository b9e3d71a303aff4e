"""What tests of several rooms share: robots with any number of limbs, fixed hypothesis seeds."""

from __future__ import annotations

import os
import signal
from collections.abc import Callable
from ctypes.util import find_library

import pytest
from hypothesis import settings

import climbplan.cli.app  # noqa: F401  # one thread in BLAS, as commands have it: before NumPy
from climbplan.schema.robots.robot import RobotSpec

# Before any test loads MuJoCo, which looks at this once: pictures are drawn off screen
if not {"MUJOCO_GL", "DISPLAY", "WAYLAND_DISPLAY"} & set(os.environ) and find_library("EGL"):
    os.environ["MUJOCO_GL"] = "egl"

# Started in the background or by nohup, Python ignores Ctrl-C, and so would what tests start
if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)

settings.register_profile("same-every-run", derandomize=True, deadline=None, max_examples=30)
settings.load_profile("same-every-run")


def braced_robot(limbs: int, seed: int = 0) -> RobotSpec:
    """A robot with limbs on both sides of its body, left ones and right ones facing their wall.

    The seed varies lengths, stiffnesses, torque limits, mass and shares within some 20 %.
    """
    import numpy as np

    rng = np.random.default_rng(seed)

    def about(value: float) -> float:
        return float(value * rng.uniform(0.85, 1.15)) if seed else value

    right = (limbs + 1) // 2
    rows = []
    for index in range(limbs):
        side = 1.0 if index < right else -1.0
        row, count = (index, right) if side > 0 else (index - right, limbs - right)
        y = 0.35 - 0.7 * row / (count - 1) if count > 1 else 0.0
        rows.append(
            {
                "name": f"{'R' if side > 0 else 'L'}{row + 1}",
                "side": "right" if side > 0 else "left",
                "shoulder": (side * 0.2, 0.6 * y, 0.0),
                "mount_yaw_deg": 0.0 if side > 0 else 180.0,
                "link_lengths": (about(0.057), about(0.195), about(0.375)),
                "max_torque": (about(25.0), about(25.0), about(25.0)),
                "joint_stiffness": (about(40.0), about(40.0), about(40.0)),
                "joint_lower_deg": (-80.0, -90.0, -120.0),
                "joint_upper_deg": (80.0, 120.0, 120.0),
                "stance": (side * 0.6, y, -0.15 - 0.01 * index),
            }
        )
    return RobotSpec.model_validate(
        {
            "name": f"braced {limbs}",
            "mass": about(9.0),
            "structural_compliance_share": 0.3,
            "body_half_size": (0.12, 0.2, 0.05),
            "workspace": {"reach": 0.55, "stance_radius": 0.15},
            "limbs": rows,
        }
    )


def pytest_addoption(parser: pytest.Parser) -> None:
    """Options for how many mutated files are tried."""
    group = parser.getgroup("climbplan")
    group.addoption("--fuzz-cases", type=int, default=150, help="mutated files [150]")
    group.addoption("--fuzz-seed", type=int, default=0, help="what decides which [0]")


@pytest.fixture(name="braced_robot")
def _braced_robot() -> Callable[..., RobotSpec]:
    return braced_robot
