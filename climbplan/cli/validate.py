"""`climbplan validate`: all mistakes of specs, without planning anything."""

from __future__ import annotations

import dataclasses
from typing import TYPE_CHECKING, Annotated, Any, cast

import typer

from climbplan.api.mistakes import placed_mistakes
from climbplan.cli.console import print_error, print_json, print_result, warn
from climbplan.cli.options import Json, Quiet, Set, Verbose
from climbplan.errors import ExitCode

if TYPE_CHECKING:
    from climbplan.bookshelf.schema.loading import LoadedShelf
    from climbplan.climb.schema.loading import LoadedClimb
    from climbplan.climb.schema.transition_loading import LoadedTransition
    from climbplan.schema.loading import AnyLoaded
    from climbplan.schema.robots.source import AnyRobot
    from climbplan.walking.schema.loading import LoadedMpc


def validate(
    specs: Annotated[
        list[str], typer.Argument(metavar="SPEC...", help="Spec files, or - for standard input.")
    ],
    assignments: Set = None,
    as_json: Json = False,
    quiet: Quiet = False,
    verbose: Verbose = False,
) -> None:
    """Check specs of any kind and list every mistake with its file, line and key.

    Exit code 2 if there is one.
    """
    from climbplan.errors import SpecError
    from climbplan.schema.loading import load_spec

    results: list[dict[str, Any]] = []
    for spec in specs:
        try:
            loaded = load_spec(spec, assignments or ())
            kind = _checked_kind(loaded)
        except SpecError as error:
            mistakes = [dataclasses.asdict(mistake) for mistake in error.mistakes]
            results.append({"spec": spec, "valid": False, "mistakes": mistakes})
            if not as_json:
                print_error(error)
        else:
            results.append({"spec": spec, "valid": True, "kind": kind, "mistakes": []})
            if not as_json:
                print_result(f"{spec}: ok ({kind})")
    if as_json:
        print_json({"specs": results})
    if not all(result["valid"] for result in results):
        raise typer.Exit(ExitCode.USAGE)


def _checked_kind(loaded: AnyLoaded) -> str:
    """Return the kind of a spec, after its scene was built as the planner builds it.

    Raises:
        SpecError: with the mistakes that only this finds.
    """
    spec: Any = getattr(loaded, "spec", loaded)
    kind = str(spec.kind)
    if kind == "mpc":
        _check_walk(cast("LoadedMpc", loaded))
    elif kind == "bookshelf":
        _check_shelf(cast("LoadedShelf", loaded))
    elif kind == "climb":
        _check_climb(cast("LoadedClimb", loaded))
    elif kind == "transition":
        _check_transition(cast("LoadedTransition", loaded))
    elif kind == "robot":
        from climbplan.robots.any_robot import build_robot

        build_robot(cast("AnyRobot", loaded))
    return kind


def _check_walk(loaded: LoadedMpc) -> None:
    from climbplan.walking.problem.problem import build_task

    if loaded.spec.terrain.scan is not None:
        from climbplan.walking.problem.scanning import fit_walk_scan

        loaded = fit_walk_scan(loaded)
    with placed_mistakes(loaded):
        build_task(loaded.spec, loaded.robot, loaded.source)


def _check_shelf(loaded: LoadedShelf) -> None:
    from climbplan.bookshelf.scene.oddities import find_oddities
    from climbplan.bookshelf.scene.scene_source import build_shelf, load_scenes

    for line in find_oddities(load_scenes(loaded), build_shelf(loaded.spec.shelf)):
        warn(f"{loaded.source}: {line}")


def _check_climb(loaded: LoadedClimb) -> None:
    from climbplan.climb.planner.start_from_plan import resolve_start_plan
    from climbplan.climb.scene.climb_scene import apply_scan, build_scene

    loaded = apply_scan(resolve_start_plan(loaded))
    with placed_mistakes(loaded):
        build_scene(loaded.spec, loaded.robot, loaded.source, loaded.directory)


def _check_transition(loaded: LoadedTransition) -> None:
    from climbplan.climb.scene.climb_scene import apply_scan
    from climbplan.climb.transition.scene import build_transition

    loaded = apply_scan(loaded)
    with placed_mistakes(loaded):
        build_transition(loaded)
