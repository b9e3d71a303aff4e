"""`climbplan.problem_from_spec`: the optimisation problem of a spec, for any method."""

from __future__ import annotations

import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from climbplan.api.ctrl_c import ctrl_c_insists
from climbplan.api.loading import SpecSource, load_spec, override_spec
from climbplan.api.mistakes import placed_mistakes
from climbplan.arrays import Array
from climbplan.bookshelf.schema.loading import LoadedShelf
from climbplan.climb.schema.loading import LoadedClimb
from climbplan.climb.schema.transition_loading import LoadedTransition
from climbplan.deprecation import renamed_parameters
from climbplan.errors import UsageError
from climbplan.program.problem import Problem
from climbplan.schema.loaded import LoadedSpec
from climbplan.solvers.model_files import is_model_file
from climbplan.solvers.model_files.reading import problem_from_file
from climbplan.walking.schema.loading import LoadedMpc

ProblemAndParameters = tuple[Problem, dict[str, Array]]


@renamed_parameters(set="overrides")
@ctrl_c_insists()
def problem_from_spec(
    spec: SpecSource | LoadedSpec, overrides: Mapping[str, Any] | None = None
) -> ProblemAndParameters:
    """Formulate the optimisation problem of a spec: `climbplan.solve(problem, theta, ...)`.

    - A climb gives its posture problem in the mixed-integer formulation of method `micp`, without
      contact forces. With `solver.method: nlp` it is the nonlinear formulation with exact
      rotations, at its first starting point.
    - A transition gives its motion for the best contact sequence of the search, or for the one
      that the spec names. `pose` is where a round starts, so the first is fixed; costs are 100
      times those of the plan.
    - A walk gives all knots, with contacts as binaries, from the gait `solver.initial_gait`. Knot n
      has `state{n}` (position, velocity, roll pitch yaw, angular velocity), `toe{n}` (x, y of each
      leg), `force{n}` and `contact{n}`.
    - A bookshelf spec gives its only scene.
    - A model file (.mps, .lp, .nl, .qplib) gives the problem that it states, without parameters.

    Rows may be added before the problem is solved: `problem.program.between("mine", ...)` on
    `problem.program.affine(...)`; `problem.program.variables` lists the variables. Solutions have
    to pass the problem's exact checker where it has one (exact rotations, transitions, walks,
    bookshelves). Methods of the table see the formulation alone: their `branch-and-bound` is
    slower than the planner's `micp`, which uses the structure.

    Args:
        spec: the result of `climbplan.load_spec`, anything that it takes, or a model file.
        overrides: values by dotted key, as with `--set`.

    Returns:
        The problem, and the values of its parameter blocks by name.

    Raises:
        SpecError: the spec has mistakes.
        UsageError: the kind has no formulation, or the spec names a file of several scenes.
        NoPlanFound: the search has no contact sequence for a transition.
    """
    if isinstance(spec, (str, Path)) and is_model_file(str(spec)):
        if overrides:
            raise UsageError(f"{spec}: a model file has no keys to override")
        return problem_from_file(spec), {}
    if isinstance(spec, LoadedSpec):
        loaded: object = override_spec(spec, overrides) if overrides else spec
    else:
        loaded = load_spec(spec, overrides)
    maker = next((factory for kind, factory in _MAKERS.items() if isinstance(loaded, kind)), None)
    if maker is None or not isinstance(loaded, LoadedSpec):
        kind = getattr(getattr(loaded, "spec", None), "kind", type(loaded).__name__)
        raise UsageError(
            "problems are stated by specs of kind climb, transition, mpc and bookshelf; "
            f"this is of kind {kind}"
        )
    with placed_mistakes(loaded):
        return maker(loaded)


def _climb(loaded: LoadedClimb) -> ProblemAndParameters:
    from climbplan.climb.postures.nlp.method import generate_guesses
    from climbplan.climb.postures.nlp.problem import build_posture_problem
    from climbplan.climb.postures.planner import reject_nonconvex
    from climbplan.climb.postures.statement import build_posture_program
    from climbplan.climb.scene.climb_scene import build_scene

    scene = build_scene(loaded.spec, loaded.robot, loaded.source, loaded.directory)
    solver = loaded.spec.solver
    if solver.method == "nlp":
        return build_posture_problem(
            scene, next(generate_guesses(scene, 1, time.monotonic() + solver.time_limit))
        )
    reject_nonconvex(scene)
    return Problem("postures", build_posture_program(scene)), {}


def _transition(loaded: LoadedTransition) -> ProblemAndParameters:
    from climbplan.climb.transition.problem import formulate_transition

    return formulate_transition(loaded)


def _walk(loaded: LoadedMpc) -> ProblemAndParameters:
    from climbplan.walking.offline.walk_problem import walk_problem
    from climbplan.walking.problem.problem import build_task
    from climbplan.walking.problem.scanning import fit_walk_scan, load_walk_surface

    loaded = fit_walk_scan(loaded)
    scan = load_walk_surface(loaded)
    task = build_task(loaded.spec, loaded.robot, loaded.source, scan=scan)
    return walk_problem(task, loaded.spec.solver.initial_gait)


def _shelf(loaded: LoadedShelf) -> ProblemAndParameters:
    from climbplan.bookshelf.scene.scene_source import build_shelf, load_scenes
    from climbplan.bookshelf.statement.points import build_theta
    from climbplan.bookshelf.statement.shelf_problem import build_shelf_problem

    scenes = load_scenes(loaded)
    if len(scenes) != 1:
        raise UsageError(f"{loaded.source}: expected one scene, got {len(scenes)}")
    shelf = build_shelf(loaded.spec.shelf)
    return build_shelf_problem(scenes.count, shelf, loaded.spec.formulation), build_theta(scenes[0])


_MAKERS: dict[type, Any] = {
    LoadedClimb: _climb,
    LoadedTransition: _transition,
    LoadedMpc: _walk,
    LoadedShelf: _shelf,
}
