"""`climbplan.stated`: what a spec asks for, as a problem that every method of the table takes."""

from __future__ import annotations

import time
from collections.abc import Mapping
from typing import Any

from climbplan.api.ctrl_c import ctrl_c_insists
from climbplan.api.loading import SpecSource, changed, load
from climbplan.api.mistakes import placed_mistakes
from climbplan.arrays import Array
from climbplan.bookshelf.schema.loading import LoadedShelf
from climbplan.climb.schema.loading import LoadedClimb
from climbplan.climb.schema.transition_loading import LoadedTransition
from climbplan.errors import UsageError
from climbplan.program.problem import Problem
from climbplan.schema.loaded import LoadedSpec
from climbplan.walking.schema.loading import LoadedMpc

Stated = tuple[Problem, dict[str, Array]]


@ctrl_c_insists()
def stated(spec: SpecSource | LoadedSpec, set: Mapping[str, Any] | None = None) -> Stated:
    """The problem that a spec states, and its parameters: `climbplan.solve(problem, theta, ...)`.

    spec, set: as `climbplan.plan`. A climb: its postures as method `micp` has them, forces apart;
    with `solver.method` nlp as that has them, rotations exact, from its first start.
    A transition, of a mission that before the climb: its motion from the best sequence of the
    search, which is free unless the spec names one; `pose` is where a round starts, so that the
    first is given, and costs are 100 times those of the plan. A walk: all knots, contacts as
    binaries, from the guessed gait (`solver.guess`); of knot n `state{n}` (position, velocity,
    roll pitch yaw, angular velocity), `toe{n}` (x, y of each leg), `force{n}` and `contact{n}`. A
    bookshelf: its only scene.

    Rows may be added before it is solved, `problem.program.between("mine", ...)` on
    `problem.program.affine(...)`; `problem.program.variables` says what there is. Answers have to
    pass the problem's own exact checker where it has one (exact rotations, transitions, walks,
    bookshelves). A method of the table knows the statement only: `micp`, for one, is not the
    planner's of that name, which knows the problem's structure and is much faster.

    Raises SpecError for mistakes, UsageError for other kinds and for files of several scenes,
    NoPlanFound where the search has no sequence for a transition.
    """
    if isinstance(spec, LoadedSpec):
        loaded: object = changed(spec, set) if set else spec
    else:
        loaded = load(spec, set)
    maker = next((made for kind, made in _MAKERS.items() if isinstance(loaded, kind)), None)
    if maker is None or not isinstance(loaded, LoadedSpec):
        kind = getattr(getattr(loaded, "spec", None), "kind", type(loaded).__name__)
        raise UsageError(
            "problems are stated by specs of kind climb, transition, mpc and bookshelf; "
            f"this is of kind {kind}"
        )
    with placed_mistakes(loaded):
        return maker(loaded)


def _climb(loaded: LoadedClimb) -> Stated:
    from climbplan.climb.postures.nlp.method import guesses
    from climbplan.climb.postures.nlp.stated import posture_problem
    from climbplan.climb.postures.planner import refuse_unsuitable
    from climbplan.climb.postures.statement import posture_program
    from climbplan.climb.scene.climb_scene import build_scene

    scene = build_scene(loaded.spec, loaded.robot, loaded.source, loaded.directory)
    solver = loaded.spec.solver
    if solver.method == "nlp":
        return posture_problem(scene, next(guesses(scene, 1, time.monotonic() + solver.time_limit)))
    refuse_unsuitable(scene)
    return Problem("postures", posture_program(scene)), {}


def _transition(loaded: LoadedTransition) -> Stated:
    from climbplan.climb.transition.problem import stated_transition

    return stated_transition(loaded)


def _walk(loaded: LoadedMpc) -> Stated:
    from climbplan.walking.offline.stated import walk_problem
    from climbplan.walking.problem.problem import build_task

    task = build_task(loaded.spec, loaded.robot, loaded.source)
    return walk_problem(task, loaded.spec.solver.guess)


def _shelf(loaded: LoadedShelf) -> Stated:
    from climbplan.bookshelf.scene.scene_source import loaded_scenes, shelf_of
    from climbplan.bookshelf.statement.points import theta_of
    from climbplan.bookshelf.statement.stated import shelf_problem

    scenes = loaded_scenes(loaded)
    if len(scenes) != 1:
        raise UsageError(f"a problem is stated by one scene, {loaded.source} has {len(scenes)}")
    shelf = shelf_of(loaded.spec.shelf)
    return shelf_problem(scenes.count, shelf, loaded.spec.meaning), theta_of(scenes[0])


_MAKERS: dict[type, Any] = {
    LoadedClimb: _climb,
    LoadedTransition: _transition,
    LoadedMpc: _walk,
    LoadedShelf: _shelf,
}
