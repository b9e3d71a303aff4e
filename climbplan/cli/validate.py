"""`climbplan validate`: all mistakes of specs, without planning anything."""

from __future__ import annotations

import dataclasses
from typing import TYPE_CHECKING, Annotated, Any

import typer

from climbplan.api.mistakes import placed_mistakes
from climbplan.cli.console import print_error, print_json, print_result, warn
from climbplan.cli.options import Json, Quiet, Set, Verbose
from climbplan.errors import ExitCode

if TYPE_CHECKING:
    from climbplan.spec.loading import AnyLoaded


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
    from climbplan.spec.loading import load_spec

    results: list[dict[str, Any]] = []
    for spec in specs:
        try:
            loaded = load_spec(spec, assignments or ())
            kind = _kind_looked_into(loaded)
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


def _kind_looked_into(loaded: AnyLoaded) -> str:
    """The kind of a spec whose scene was looked at as its planner does.

    Raises:
        SpecError: with the mistakes that only this finds.
    """
    from climbplan.spec.bookshelf.loading import LoadedShelf
    from climbplan.spec.climb.transition_loading import LoadedTransition
    from climbplan.spec.datasets.loading import LoadedDataset
    from climbplan.spec.fits.envelopes_loading import LoadedEnvelopes
    from climbplan.spec.fits.strategy_loading import LoadedStrategy
    from climbplan.spec.limms.loading import LoadedLimms
    from climbplan.spec.loading import LoadedClimb
    from climbplan.spec.program.loading import LoadedProgram
    from climbplan.spec.robots.urdf.source import UrdfRobot
    from climbplan.spec.walking.loading import LoadedMpc

    if isinstance(
        loaded, LoadedDataset | LoadedEnvelopes | LoadedLimms | LoadedProgram | LoadedStrategy
    ):
        return loaded.spec.kind
    if isinstance(loaded, LoadedMpc):
        from climbplan.walking.problem import build_task

        with placed_mistakes(loaded):
            build_task(loaded.spec, loaded.robot, loaded.source)
        return loaded.spec.kind
    if isinstance(loaded, LoadedShelf):
        from climbplan.bookshelf.oddities import oddities
        from climbplan.bookshelf.scene_source import loaded_scenes, shelf_of

        for line in oddities(loaded_scenes(loaded), shelf_of(loaded.spec.shelf)):
            warn(f"{loaded.source}: {line}")
        return loaded.spec.kind
    if isinstance(loaded, LoadedClimb):
        from climbplan.climb.chaining import started
        from climbplan.climb.scene import build_scene, on_scan

        loaded = on_scan(started(loaded))
        with placed_mistakes(loaded):
            build_scene(loaded.spec, loaded.robot, loaded.source, loaded.directory)
        return loaded.spec.kind
    if isinstance(loaded, LoadedTransition):
        from climbplan.climb.scene import on_scan
        from climbplan.climb.transition.scene import build_transition

        loaded = on_scan(loaded)
        with placed_mistakes(loaded):
            build_transition(loaded)
        return loaded.spec.kind
    if isinstance(loaded, UrdfRobot):
        from climbplan.robots.any_robot import build_robot

        build_robot(loaded)
    return loaded.kind
