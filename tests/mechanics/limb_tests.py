"""Force-displacement tests of a limb whose stiffness is known."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from climbplan.mechanics.identification.limb_model import MeasuredLimb, limb_matrices
from climbplan.mechanics.identification.measurements import AXES
from climbplan.robots.model import Robot
from climbplan.schema.robots.source import load_robot

SILVIA = Robot.from_spec(load_robot("silvia"))


@dataclass(frozen=True)
class Truth:
    """A limb and how well it is measured."""

    stiffness: tuple[float, float, float] = (40.0, 55.0, 30.0)  # at gain 12 [N m/rad]
    even: float = 0.0  # structure alike in all directions [m/N]
    shape: float = 0.0  # structure in the joints' shape, part of the joints' compliance at gain 12
    noise: float = 0.02  # of the largest force of a loading
    bad: float = 0.0  # share of rows that are wrong altogether
    gains: tuple[float, ...] = (12.0,)
    spatial: bool = True


def write_tests(path: Path, truth: Truth, seed: int, count: int = 12) -> None:
    """A CSV file of `count` tests, eight steps of 0.635 mm along each axis from a preload."""
    rng = np.random.default_rng(seed)
    axes = (0, 1, 2) if truth.spatial else (0, 2)
    limb = MeasuredLimb(SILVIA, axes)
    k = np.array(truth.stiffness)[list(limb.joints)]
    moved = [f"d{AXES[a]}_mm" for a in axes] + [f"f{AXES[a]}_N" for a in axes]
    lines = ["# made up", ",".join(["test,coxa_deg,femur_deg,tibia_deg,gain", *moved])]
    for test in range(count):
        angles = rng.uniform([-30, -20, -40], [30, 60, 40]) * [float(truth.spatial), 1, 1]
        gain = truth.gains[test % len(truth.gains)]
        soft = 12 / gain / k + truth.shape / k
        matrix = limb_matrices(limb.jacobians(np.deg2rad(angles)[None]), soft, truth.even)[0]
        steps = np.arange(9) * 0.635e-3
        for column in range(len(axes)):
            force = np.outer(steps, matrix[:, column])
            largest = np.abs(force).max()
            force += rng.uniform(-4, 4, len(axes)) + truth.noise * largest * rng.normal(
                size=force.shape
            )
            wrong = rng.random(len(steps)) < truth.bad
            force[wrong] += largest * rng.normal(size=(int(wrong.sum()), len(axes)))
            for step, f in zip(steps, force, strict=True):
                shift = np.zeros(len(axes))
                shift[column] = 1e3 * step
                cells = [*angles, gain, *shift, *f]
                lines.append(f"t{test}," + ",".join(f"{v:.6g}" for v in cells))
    path.write_text("\n".join(lines) + "\n")
