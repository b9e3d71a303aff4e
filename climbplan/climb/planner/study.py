"""Feasible regions: the same task planned over a grid of spec values (Fig. 5.7)."""

from __future__ import annotations

import itertools

import numpy as np

from climbplan.climb.motion.motion import StageClock, plan_motion, plan_support
from climbplan.climb.motion.trajectory import plan_trajectory
from climbplan.climb.plan.climb_plan import Study
from climbplan.climb.scene.climb_scene import build_scene
from climbplan.climb.schema.loading import LoadedClimb
from climbplan.errors import NoPlanFound, UsageError
from climbplan.progress import Progress

_FEASIBLE, _NO_FORCE, _NO_POSTURE = range(3)  # index into Study.LABELS


def _label_cell(loaded: LoadedClimb, values: dict[str, float]) -> tuple[int, str]:
    """Return the label and the message of one grid point, planned by one method.

    Method `auto` would spend its whole time limit on every point without a plan. A study therefore
    plans by its first method, `micp`.
    """
    climb = loaded.with_overrides([f"{key}={value!r}" for key, value in values.items()])
    scene = build_scene(climb.spec, climb.robot, climb.source, climb.directory)
    clock = StageClock(lambda stage, fraction: None)
    try:
        motion = plan_motion(scene, clock)
    except NoPlanFound as error:
        return _NO_POSTURE, str(error).splitlines()[0]
    try:
        supported = plan_support(scene, motion, clock)
        motion, forces = supported.motion, supported.forces
        plan_trajectory(scene, motion.posture.rounds, motion.instants, forces, motion.swings)
    except NoPlanFound as error:
        conflicts = error.conflicts
        return _NO_FORCE, str(conflicts[0]) if conflicts else str(error)
    return _FEASIBLE, ""


def run_study(loaded: LoadedClimb, jobs: int, report: Progress) -> Study:
    """Label every grid point; the result does not depend on the number of workers.

    Raises UsageError if the spec has no study.
    """
    if loaded.spec.study is None:
        raise UsageError("the spec has no `study`")
    grid = loaded.spec.study.grid
    cells = [dict(zip(grid, v, strict=True)) for v in itertools.product(*grid.values())]
    results: list[tuple[int, str]] = []
    from joblib import Parallel, delayed

    work = Parallel(n_jobs=jobs, return_as="generator")(
        delayed(_label_cell)(loaded, cell) for cell in cells
    )
    for result in work:
        results.append(result)
        report("study", len(results) / len(cells))
    shape = [len(v) for v in grid.values()]
    if len(shape) == 1:
        shape.append(1)
    return Study(
        keys=tuple(grid),
        values=tuple(np.array(v, float) for v in grid.values()),
        label=np.array([label for label, _ in results], np.int64).reshape(shape),
        detail=tuple(detail for _, detail in results),
    )
