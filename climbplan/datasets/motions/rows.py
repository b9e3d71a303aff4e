"""Motions as rows of a dataset: scenes drawn, planned, verified, simulated, exported.

parameters: robot, scene, seed of the ground, and the drawn numbers of all scenes (0 in rows of
other scenes). A row is feasible if its plan passed its verification; it is usable if it also stands
in MuJoCo and its motion keeps the limits of `climbplan measure`. Usable rows alone have files.
"""

from __future__ import annotations

import hashlib
import math
import tempfile
import time
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from climbplan.arrays import Array
from climbplan.datasets.motions.motion_trial import (
    SimulatedEnd,
    VerifiedMotionPlan,
    find_fast_motion,
    plan_motion,
    read_motion,
    simulate_motion,
    time_by_dynamics,
)
from climbplan.datasets.motions.scenes import SceneFamilies, SceneSample
from climbplan.errors import ClimbplanError, Infeasible, NoPlanFound
from climbplan.motions.measure import measure_motion
from climbplan.motions.motion_file import name_terrain_file, write_motion_file
from climbplan.motions.tracked_motion import TrackedMotion
from climbplan.schema.loaded import LoadedSpec
from climbplan.simulation.mujoco_loading import load_mujoco
from climbplan.store.dataset import DatasetFrame, build_solution_layout
from climbplan.store.dataset_row import RowAnswer

KIND = "motions"
FOLDER = "motions"  # beside the dataset, of the files
OBJECTIVE_UNIT = "s"  # of a motion's duration
LAYOUTS = {
    "usable": build_solution_layout((), kind="bool"),
    "pace": build_solution_layout((), "of planned"),
    "samples": build_solution_layout((), kind="int"),
    "slips": build_solution_layout((), kind="int"),
    "lost_contacts": build_solution_layout((), kind="int"),
    "slip": build_solution_layout((), "m"),
    "penetration": build_solution_layout((), "m"),
    "cpu_plan": build_solution_layout((), "s"),
    "cpu_simulation": build_solution_layout((), "s"),
    "motion": build_solution_layout((), "path", kind="text"),
    "sha256": build_solution_layout((), kind="text"),
    "terrain": build_solution_layout((), "path", kind="text"),
    "terrain_sha256": build_solution_layout((), kind="text"),
}
_MAX_REASON = 300  # letters of why there is no plan


@dataclass(frozen=True)
class MotionForm:
    """How motions are written."""

    rate: float  # [Hz] of samples
    pace: str  # "planned", "fastest" or "dynamic"
    keeps_plans: bool  # whether plan files are among the files of a row


class MotionRows:
    """Draws scenes and makes their motions."""

    def __init__(self, families: SceneFamilies, form: MotionForm) -> None:
        """Raise MissingSolver without MuJoCo, and SpecError for a scene's spec with a mistake.

        Args:
            families: What scenes are drawn from.
            form: How motions are written.
        """
        load_mujoco()
        families.require_specs()
        self._families, self._form = families, form
        self._frame = build_frame(families, form)

    @property
    def frame(self) -> DatasetFrame:
        """Robots, scenes and columns."""
        return self._frame

    def draw(self, rng: np.random.Generator) -> SceneSample:
        """Return a drawn scene."""
        return self._families.draw(rng)

    def parameters(self, sample: SceneSample) -> Array:
        """Return the numbers of a scene."""
        return self._families.encode(sample)

    def solve(self, sample: SceneSample) -> RowAnswer:
        """Plan, verify, simulate and export the motion of a scene.

        What cannot be planned is a row with its reason. Messages name no temporary places, so that
        equal rows have equal ones.
        """
        with tempfile.TemporaryDirectory() as name:
            folder = Path(name)
            begin = time.perf_counter()
            try:
                trial = self._run(sample, folder)
            except ClimbplanError as error:
                text = str(error).replace(f"{folder}/", "")
                reason = "; ".join(line.strip() for line in text.splitlines()[:2])[:_MAX_REASON]
                status = "limit" if isinstance(error, NoPlanFound) else "failed"
                if isinstance(error, Infeasible):
                    status = "infeasible"
                duration = time.perf_counter() - begin
                return RowAnswer(status, reason, time=duration, bound=-math.inf)
            return replace(trial, time=time.perf_counter() - begin)

    def _run(self, sample: SceneSample, folder: Path) -> RowAnswer:
        loaded = self._families.load(sample, folder)
        if self._form.pace == "dynamic":
            loaded = time_by_dynamics(loaded)
        planned = plan_motion(loaded, folder / f"{sample.name}.h5")
        if planned.objection:
            return RowAnswer("failed", f"the plan {planned.objection}")
        begin = time.process_time()
        end = simulate_motion(loaded, planned.path)
        cpu = time.process_time() - begin
        return self._export(sample, loaded, planned, end, cpu)

    def _export(
        self,
        sample: SceneSample,
        loaded: LoadedSpec,
        planned: VerifiedMotionPlan,
        end: SimulatedEnd,
        cpu_simulation: float,
    ) -> RowAnswer:
        motion = read_motion(loaded, planned.path, self._form.rate, sample.name)
        if self._form.pace == "fastest" and end.fall is None:
            begin = time.process_time()
            fast = find_fast_motion(loaded, planned.path, self._form.rate, sample.name)
            motion, end = fast or (motion, end)
            cpu_simulation += time.process_time() - begin
        checks = measure_motion(motion, {})
        broken = [check.name for check in checks if not check.passed]
        residuals = {check.name: check.residual for check in checks if check.judged}
        reason = "" if end.fall is None else f"falls at {end.fall:.1f} s in MuJoCo"
        if broken and not reason:
            reason = f"its motion breaks {', '.join(broken)}"
        duration = float(motion.time[-1])
        row: dict[str, Any] = {
            "usable": not reason,
            "pace": motion.facts.get("pace", 1.0),
            "samples": len(motion.time),
            "slips": end.num_slips,
            "lost_contacts": end.num_lost_contacts,
            "slip": residuals.get("contact.slip", 0.0),
            "penetration": residuals.get("contact.penetration", 0.0),
            "cpu_plan": planned.cpu,
            "cpu_simulation": cpu_simulation,
            "motion": "",
            "sha256": "",
            "terrain": "",
            "terrain_sha256": "",
        }
        files = {} if reason else self._write_files(motion, end, planned.path)
        paths = list(files)
        if paths:
            row |= {"motion": paths[0], "sha256": compute_digest(files[paths[0]])}
            row |= {"terrain": paths[1], "terrain_sha256": compute_digest(files[paths[1]])}
        return RowAnswer(
            status=planned.status,
            message=reason,
            solution={name: np.asarray(value) for name, value in row.items()},
            integers=np.zeros(0, np.int64),
            objective=duration,
            files=files,
        )

    def _write_files(
        self, motion: TrackedMotion, end: SimulatedEnd, plan: Path
    ) -> dict[str, bytes]:
        """Return the files of a usable row by their paths: motion, terrain, plan."""
        facts = {
            **motion.facts,
            "verification": "passed",
            "simulation": "stands in MuJoCo",
            "slips": end.num_slips,
            "lost_contacts": end.num_lost_contacts,
        }
        path = plan.with_suffix(".npz")
        write_motion_file(replace(motion, facts=facts), path)
        written = [path, name_terrain_file(path), *([plan] if self._form.keeps_plans else [])]
        return {f"{FOLDER}/{file.name}": file.read_bytes() for file in written}


def build_frame(families: SceneFamilies, form: MotionForm) -> DatasetFrame:
    """Return what rows of the same robots and scenes share."""
    return DatasetFrame(
        kind=KIND,
        problem=", ".join(families.labels),
        facts={
            "robots": [walker.name for walker in families.walkers],
            "scenes": list(families.labels),
            "rate": form.rate,
            "pace": form.pace,
        },
        parameter_names=families.parameter_names,
        integer_names=(),
        layouts=LAYOUTS,
        objective_unit=OBJECTIVE_UNIT,
    )


def compute_digest(content: bytes) -> str:
    """Return the SHA-256 of bytes, in hexadecimal digits."""
    return hashlib.sha256(content).hexdigest()
