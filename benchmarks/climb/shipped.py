"""Shipped climbs, transitions and missions, planned for benchmarks."""

from __future__ import annotations

import tempfile
import time
from dataclasses import dataclass
from pathlib import Path

import yaml

from climbplan.climb.check.verification import verify_plan
from climbplan.climb.plan.climb_plan import ClimbPlan
from climbplan.climb.planner.planner import plan_climb
from climbplan.climb.schema.loading import load_climb
from climbplan.climb.schema.transition_loading import load_transition
from climbplan.climb.transition.planner import plan_transition
from climbplan.schema.examples import read_example, read_example_data

SCENES = (  # that MuJoCo can play
    "climb_nonparallel",
    "climb_region",
    "climb_patches",
    "climb_obstacle",
    "climb_steps",
    "climb_stairs",
    "climb_tube",
    "climb_tube_mesh",
    "climb_walker",
    "climb_ground_to_wall",
    "climb_single_wall",
    "climb_ceiling",
    "transition_flat",
    "transition_bricks",
    "transition_bricks_4",
    "mission_ground_to_top",
)


@dataclass(frozen=True)
class Planned:
    """A plan, and what it cost."""

    plan: ClimbPlan
    cpu: float  # [s]
    fragile: bool

    @property
    def safety_torque(self) -> float:
        """The least S_tau."""
        return float(self.plan.forces.safety_torque.min())


def planned_scene(name: str, overrides: list[str]) -> Planned:
    """A shipped spec planned with overrides."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder, f"{name}.yaml")
        path.write_text(read_example(name))
        for data, content in read_example_data(name).items():
            path.with_name(data).write_bytes(content)
        return planned_spec(path, overrides)


def planned_spec(path: Path, overrides: list[str]) -> Planned:
    """A spec planned and verified; a study beside the plan is left out."""
    text = path.read_text()
    start = time.process_time()
    if yaml.safe_load(text)["kind"] == "transition":
        plan = plan_transition(load_transition(path, overrides))
    else:
        study = ["study=null"] if "\nstudy:" in text else []
        plan = plan_climb(load_climb(path, [*study, *overrides]))
    spent = time.process_time() - start
    return Planned(plan, spent, bool(verify_plan(plan).fragile))
