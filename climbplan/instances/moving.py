"""Instances of walks, modules, shelves and cart-poles."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from climbplan.bookshelf.scene.generator import build_drop_shelf, generate_scene
from climbplan.bookshelf.statement.points import build_theta
from climbplan.bookshelf.statement.shelf_problem import build_shelf_problem
from climbplan.instances.cart_pole import build_walled_cart_pole
from climbplan.instances.climbing import build_linear_instance
from climbplan.limms.consensus.mixed_integer import MixedIntegerBlock
from climbplan.limms.consensus.problem import build_problem
from climbplan.limms.scene.limms_scene import build_scene
from climbplan.limms.schema.loading import limms_of
from climbplan.program.instance import Instance
from climbplan.schema.document import Document
from climbplan.schema.examples import read_example
from climbplan.schema.overrides import apply_overrides
from climbplan.schema.source import SourceText
from climbplan.schema.yaml_source import parse_yaml
from climbplan.walking.dynamics.cost import compute_objective
from climbplan.walking.micp.attitude_box import build_attitude_box
from climbplan.walking.micp.relaxation import build_relaxation
from climbplan.walking.offline.nlp import generate_guesses
from climbplan.walking.problem.problem import build_task
from climbplan.walking.schema.loading import validate_mpc

_TANGENTS = 1.5  # ratio from one tangent of a square to the next
_MAX_COST_RATIO = 2.0  # largest cost of a walk, as a multiple of the guess's cost


def build_book_instance(rng: np.random.Generator, stored: int) -> Instance:
    """Build the insertion of a book into a shelf of `stored` books, with products (8.1)."""
    scene = generate_scene(int(rng.integers(1 << 30)), 0, stored)
    return build_shelf_problem(stored, build_drop_shelf(stored), "contact").instance(
        build_theta(scene)
    )


def build_cart_pole_instance(rng: np.random.Generator, steps: int) -> Instance:
    """Build a pole between soft walls after a random push (arXiv 1912.01110)."""
    problem = build_walled_cart_pole(steps)
    return problem.instance(problem.sample_parameters(rng))


def build_walk_instance(rng: np.random.Generator, knots: int) -> Instance:
    """Build the relaxation of a walk with partitioned arms and tangents of costs (8.2)."""
    speed = [round(float(v), 3) for v in rng.uniform([0.2, -0.3], [1.8, 0.3])]
    overrides = [
        f"task.knots={knots}",
        "task.integrator=euler",
        f"task.reference.velocity=[{speed[0]}, {speed[1]}, 0]",
    ]
    loaded = validate_mpc(*_load_example("mpc_forward", overrides))
    task = build_task(loaded.spec, loaded.robot, loaded.source)
    _, guess = next(generate_guesses(task, "trot"))
    ranges = np.deg2rad([10.0, 10.0, 10.0]), np.array([2.0, 2.0, 2.0])
    force = np.concatenate([guess.force, np.zeros((1, 4, 3))])
    max_cost = _MAX_COST_RATIO * compute_objective(task, guess.state, force)
    tube = build_attitude_box(task, guess.state, *ranges)
    return build_linear_instance(
        build_relaxation(task, tube, max_cost, 1, 1, _TANGENTS).model, "walks"
    )


def build_module_instance(rng: np.random.Generator, intervals: int) -> Instance:
    """Build the mixed-integer block of who holds the box and the wall, and when (eq. 6.12a)."""
    goal = rng.uniform([0.7, -0.2, 1.3], [0.85, 0.2, 1.5])
    overrides = [
        f"box.goal={[round(float(v), 3) for v in goal]}",
        f"box.mass={round(float(rng.uniform(0.2, 0.5)), 3)}",
    ]
    loaded = limms_of(*_load_example("limms_throw", overrides))
    block = MixedIntegerBlock(build_problem(build_scene(loaded), intervals))
    instance = build_linear_instance(block.rows, "modules")
    # Without a target the consensus has no cost, and its free rows are redundant
    is_bounded = np.isfinite(instance.row_lower) | np.isfinite(instance.row_upper)
    return replace(
        instance,
        A=instance.A[is_bounded],
        row_lower=instance.row_lower[is_bounded],
        row_upper=instance.row_upper[is_bounded],
        Q=instance.Q[is_bounded],
    )


def _load_example(name: str, overrides: list[str]) -> tuple[Document, SourceText]:
    """Load a shipped spec with some keys overridden."""
    text = SourceText(name, name, Path.cwd(), read_example(name))
    return apply_overrides(parse_yaml(text.text, text.shown), overrides), text
