"""Check a loaded spec as its planner does before it plans: build its scene, walk or robot."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, cast

from climbplan.api.mistakes import placed_mistakes

if TYPE_CHECKING:
    from climbplan.bookshelf.schema.loading import LoadedShelf
    from climbplan.climb.schema.loading import LoadedClimb
    from climbplan.climb.schema.transition_loading import LoadedTransition
    from climbplan.schema.loading import AnyLoaded
    from climbplan.schema.robots.source import AnyRobot
    from climbplan.walking.schema.loading import LoadedMpc


@dataclass(frozen=True)
class ValidSpec:
    """What is known of a spec without mistakes."""

    kind: str  # such as "climb"
    warnings: tuple[str, ...]  # what is allowed and can hardly be meant so


def check_spec(loaded: AnyLoaded) -> ValidSpec:
    """Build what a spec describes as its planner builds it, and return its kind and warnings.

    Raises:
        SpecError: with the mistakes that only this finds, each with its line.
    """
    spec: Any = getattr(loaded, "spec", loaded)
    kind = str(spec.kind)
    warnings: tuple[str, ...] = ()
    if kind == "mpc":
        warnings = _check_walk(cast("LoadedMpc", loaded))
    elif kind == "bookshelf":
        warnings = _check_shelf(cast("LoadedShelf", loaded))
    elif kind == "climb":
        warnings = _check_climb(cast("LoadedClimb", loaded))
    elif kind == "transition":
        _check_transition(cast("LoadedTransition", loaded))
    elif kind == "robot":
        from climbplan.robots.any_robot import build_robot

        build_robot(cast("AnyRobot", loaded))
    return ValidSpec(kind, warnings)


def _check_walk(loaded: LoadedMpc) -> tuple[str, ...]:
    from climbplan.walking.problem.oddities import find_oddities
    from climbplan.walking.problem.problem import build_task

    if loaded.spec.terrain.scan is not None:
        from climbplan.walking.problem.scanning import fit_walk_scan

        loaded = fit_walk_scan(loaded)
    with placed_mistakes(loaded):
        task = build_task(loaded.spec, loaded.robot, loaded.source)
    return find_oddities(loaded.spec, task)


def _check_shelf(loaded: LoadedShelf) -> tuple[str, ...]:
    from climbplan.bookshelf.scene.oddities import find_oddities
    from climbplan.bookshelf.scene.scene_source import build_shelf, load_scenes

    return tuple(find_oddities(load_scenes(loaded), build_shelf(loaded.spec.shelf)))


def _check_climb(loaded: LoadedClimb) -> tuple[str, ...]:
    from climbplan.climb.planner.start_from_plan import resolve_start_plan
    from climbplan.climb.scene.climb_scene import apply_scan, build_scene

    loaded = apply_scan(resolve_start_plan(loaded))
    with placed_mistakes(loaded):
        build_scene(loaded.spec, loaded.robot, loaded.source, loaded.directory)
    return ()


def _check_transition(loaded: LoadedTransition) -> None:
    from climbplan.climb.scene.climb_scene import apply_scan
    from climbplan.climb.transition.scene import build_transition

    loaded = apply_scan(loaded)
    with placed_mistakes(loaded):
        build_transition(loaded)
