"""Rows of motions, as a worker makes them."""

from __future__ import annotations

from pathlib import Path

from climbplan.datasets.motions.rows import MotionForm, MotionRows
from climbplan.datasets.motions.scenes import SceneFamilies
from climbplan.datasets.motions.walkers import GroundRobot
from climbplan.datasets.schema.motions import MotionsProblemSpec


def build_motion_source(
    spec: MotionsProblemSpec, walkers: tuple[GroundRobot, ...], directory: Path
) -> MotionRows:
    """Return motions as a spec describes them; paths in it start from `directory`."""
    families = SceneFamilies(spec.scenes, walkers, directory, spec.solver.time_limit)
    return MotionRows(families, MotionForm(spec.rate, spec.pace, spec.plans))
