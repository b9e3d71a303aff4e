"""Walking tasks and gaits that several tests use."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from climbplan.walking.offline.footing import build_gait
from climbplan.walking.offline.gaits import repeat_gait
from climbplan.walking.problem.problem import build_task
from climbplan.walking.schema.loading import load_body
from climbplan.walking.schema.model import MpcSpec
from climbplan.walking.task.task import Gait, WalkTask

LEGS = 4  # of these tasks
PUBLISHED = {"integrator": "euler", "workspace_over_stance": False}


def walk_task(velocity: tuple[float, float, float] = (0, 0, 0), **task: object) -> WalkTask:
    """Forward walking at 1.8 m/s on flat ground from a velocity; as published if nothing else."""
    given = {**PUBLISHED, "start": {"velocity": list(velocity)}, **task}
    spec = MpcSpec.model_validate({"kind": "mpc", "task": given})
    return build_task(spec, load_body("scaler"))


def stairs_task() -> WalkTask:
    """Two level regions, the second 3 cm higher."""
    regions = [
        {"name": "floor", "x": [-1.0, 0.3], "y": [-0.6, 0.6], "height": 0.0},
        {"name": "step", "x": [0.3, 2.0], "y": [-0.6, 0.6], "height": 0.03},
    ]
    spec = MpcSpec.model_validate(
        {
            "kind": "mpc",
            "terrain": {"regions": regions},
            "task": {
                **PUBLISHED,
                "start": {"velocity": [0.6, 0, 0]},
                "reference": {"velocity": [0.8, 0, 0]},
                "min_contacts": 2,
            },
        }
    )
    return build_task(spec, load_body("scaler"))


def named(name: str, task: WalkTask, phase: int = 0) -> Gait:
    """A named gait on flat ground."""
    contact = repeat_gait(name, LEGS, task.knots, phase)
    return build_gait(contact, np.zeros(contact.shape, np.int64))


def shorter(task: WalkTask, knots: int) -> WalkTask:
    """The same over fewer intervals."""
    reference = task.reference
    return replace(
        task,
        knots=knots,
        reference=replace(
            reference,
            velocity=reference.velocity[:knots],
            euler=reference.euler[:knots],
            height=reference.height[:knots],
        ),
    )
