"""Instances of walks, modules, shelves and cart-poles."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from climbplan.bookshelf.scene.generator import generate_scene, shelf_for
from climbplan.bookshelf.statement.points import theta_of
from climbplan.bookshelf.statement.stated import shelf_problem
from climbplan.instances.cart_pole import MOST, PUSHED, walled_cart_pole
from climbplan.instances.climbing import linear_instance
from climbplan.limms.consensus.mixed_integer import MixedIntegerBlock
from climbplan.limms.consensus.problem import build_problem
from climbplan.limms.scene.limms_scene import build_scene
from climbplan.limms.schema.loading import limms_of
from climbplan.program.instance import Instance
from climbplan.schema.document import Document
from climbplan.schema.examples import example_text
from climbplan.schema.overrides import apply_overrides
from climbplan.schema.source import SourceText
from climbplan.schema.yaml_source import parse_yaml
from climbplan.walking.dynamics.cost import compute_objective
from climbplan.walking.micp.relaxation import build_relaxation
from climbplan.walking.micp.attitude_box import build_attitude_box
from climbplan.walking.offline.nlp import generate_guesses
from climbplan.walking.problem.problem import build_task
from climbplan.walking.schema.loading import validate_mpc

_TANGENTS = 1.5  # ratio from one tangent of a square to the next
_ROOM = 2.0  # times the guess's cost: what a walk may cost at most


def books(rng: np.random.Generator, stored: int) -> Instance:
    """A book goes into a shelf of so many; angles and contacts are products (8.1)."""
    scene = generate_scene(int(rng.integers(1 << 30)), 0, stored)
    return shelf_problem(stored, shelf_for(stored), "contact").instance(theta_of(scene))


def cart_poles(rng: np.random.Generator, steps: int) -> Instance:
    """A pole between soft walls, from a random push (arXiv 1912.01110)."""
    start = rng.uniform(0.2, 0.9) * PUSHED + 0.05 * rng.normal(size=4) * MOST
    problem = walled_cart_pole(steps)
    return problem.instance({"start": np.clip(start, -MOST, MOST)})


def walks(rng: np.random.Generator, knots: int) -> Instance:
    """The relaxation of a walk: gait and footholds by pieces of arms, costs by tangents (8.2)."""
    speed = [round(float(v), 3) for v in rng.uniform([0.2, -0.3], [1.8, 0.3])]
    given = [
        f"task.knots={knots}",
        "task.integrator=euler",
        f"task.reference.velocity=[{speed[0]}, {speed[1]}, 0]",
    ]
    loaded = validate_mpc(*_example("mpc_forward", given))
    task = build_task(loaded.spec, loaded.robot, loaded.source)
    _, at = next(generate_guesses(task, "trot"))
    room = np.deg2rad([10.0, 10.0, 10.0]), np.array([2.0, 2.0, 2.0])
    force = np.concatenate([at.force, np.zeros((1, 4, 3))])
    most = _ROOM * compute_objective(task, at.state, force)
    tube = build_attitude_box(task, at.state, *room)
    return linear_instance(build_relaxation(task, tube, most, 1, 1, _TANGENTS).model, "walks")


def modules(rng: np.random.Generator, intervals: int) -> Instance:
    """Who holds the box and the wall, when it flies: the mixed-integer block (eq. 6.12a)."""
    goal = rng.uniform([0.7, -0.2, 1.3], [0.85, 0.2, 1.5])
    given = [
        f"box.goal={[round(float(v), 3) for v in goal]}",
        f"box.mass={round(float(rng.uniform(0.2, 0.5)), 3)}",
    ]
    loaded = limms_of(*_example("limms_throw", given))
    block = MixedIntegerBlock(build_problem(build_scene(loaded), intervals))
    made = linear_instance(block.rows, "modules")
    # Without a target the consensus costs nothing: its free rows say nothing
    held = np.isfinite(made.row_lower) | np.isfinite(made.row_upper)
    return replace(
        made,
        A=made.A[held],
        row_lower=made.row_lower[held],
        row_upper=made.row_upper[held],
        Q=made.Q[held],
    )


def _example(name: str, given: list[str]) -> tuple[Document, SourceText]:
    """A shipped spec with some keys set."""
    text = SourceText(name, name, Path.cwd(), example_text(name))
    return apply_overrides(parse_yaml(text.text, text.shown), given), text
