"""From a spec file and overrides to validated models, with all mistakes at once."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from climbplan.errors import SpecError
from climbplan.spec.bookshelf.loading import LoadedShelf, root_paths, shelf_of_document
from climbplan.spec.climb.checks import ClimbParts, check_parts, check_study
from climbplan.spec.climb.model import ClimbSpec, PosturePlannerSpec, SolverSpec, TaskSpec
from climbplan.spec.climb.motion_loading import any_robot_of_document, part_of
from climbplan.spec.climb.terrain import TerrainSpec
from climbplan.spec.climb.transition_loading import LoadedTransition, transition_of_document
from climbplan.spec.datasets.loading import LoadedDataset, dataset_of
from climbplan.spec.document import Document, Finding
from climbplan.spec.fits.envelopes_loading import LoadedEnvelopes, envelopes_of
from climbplan.spec.fits.strategy_loading import LoadedStrategy, strategy_of
from climbplan.spec.kinds import find_kind, validate_kind
from climbplan.spec.limms.loading import LoadedLimms, limms_of, module_of
from climbplan.spec.limms.module import ModuleSpec
from climbplan.spec.loaded import LoadedSpec, origin_of
from climbplan.spec.overrides import Override, apply_overrides
from climbplan.spec.program.loading import LoadedProgram, program_of
from climbplan.spec.robots.source import AnyRobot, robot_of
from climbplan.spec.source import SourceText, read_source
from climbplan.spec.walking.loading import LoadedMpc, mpc_of
from climbplan.spec.yaml_source import parse_yaml


@dataclass(frozen=True, kw_only=True)
class LoadedClimb(LoadedSpec):
    """A climb spec, checked against its robot, and the text it came from."""

    spec: ClimbSpec
    robot: AnyRobot

    def with_overrides(self, overrides: Sequence[str | Override]) -> LoadedClimb:
        """The same climb with other values, as the points of a study are.

        Raises:
            SpecError: with every mistake that the overrides bring.
        """
        text = SourceText(self.source, self.name, self.directory, self.text)
        return _loaded(apply_overrides(self.document, overrides), text)


def load_climb(
    source: str | Path,
    overrides: Sequence[str | Override] = (),
    robot_dir: str | Path | None = None,
) -> LoadedClimb:
    """Read, override and check a climb spec and its robot.

    `source` is a path or `-` for standard input. A robot given by path is looked up from
    `robot_dir`, by default the directory of the spec (the current one for standard input).

    Raises:
        SpecError: with every mistake in spec, overrides and robot file.
    """
    text = read_source(source)
    if robot_dir is not None:
        text = replace(text, directory=Path(robot_dir))
    return _load(text, overrides)


def load_spec(source: str | Path, overrides: Sequence[str | Override] = ()) -> AnyLoaded:
    """Read, override and check a spec of any kind.

    Raises:
        SpecError: with every mistake in it.
    """
    return load_source(read_source(source), overrides)


def load_source(text: SourceText, overrides: Sequence[str | Override] = ()) -> AnyLoaded:
    """As `load_spec`, of a text that was read already."""
    document = apply_overrides(parse_yaml(text.text, text.shown), overrides)
    kind = find_kind(document)
    if isinstance(kind, Finding):
        raise SpecError(text.shown, document.mistakes([kind, *document.findings]))
    return _READERS[kind](document, text)


def load_text(text: str, name: str, overrides: Sequence[str | Override] = ()) -> LoadedClimb:
    """Check a climb spec given as text; a robot's path starts from the current directory.

    Raises:
        SpecError: with every mistake in spec, overrides and robot file.
    """
    return _load(SourceText(name, name, Path.cwd(), text), overrides)


def _load(text: SourceText, overrides: Sequence[str | Override]) -> LoadedClimb:
    return _loaded(apply_overrides(parse_yaml(text.text, text.shown), overrides), text)


def _loaded(document: Document, text: SourceText) -> LoadedClimb:
    spec, robot = _climb_of(document, text)
    return LoadedClimb(spec=spec, robot=robot, **origin_of(document, text))


def _climb_of(document: Document, text: SourceText) -> tuple[ClimbSpec, AnyRobot]:
    root_paths(document, [("task", "start", "plan"), ("terrain", "scan", "file")])
    spec, findings = validate_kind(document, "climb", ClimbSpec)
    robot, robot_mistakes = any_robot_of_document(document, text.directory)
    findings += check_parts(_parts(document, robot))
    if spec is not None:
        findings += check_study(spec)
    mistakes = [*document.mistakes(findings), *robot_mistakes]
    if spec is None or robot is None or mistakes:
        raise SpecError(document.source, mistakes)
    return spec, robot


def _parts(document: Document, robot: AnyRobot | None) -> ClimbParts:
    return ClimbParts(
        terrain=part_of(document, "terrain", TerrainSpec),
        task=part_of(document, "task", TaskSpec),
        posture=part_of(document, "posture", PosturePlannerSpec),
        solver=part_of(document, "solver", SolverSpec),
        robot=robot,
    )


AnyLoaded = (
    LoadedClimb
    | LoadedDataset
    | LoadedEnvelopes
    | LoadedLimms
    | LoadedMpc
    | LoadedProgram
    | LoadedShelf
    | LoadedStrategy
    | LoadedTransition
    | ModuleSpec
    | AnyRobot
)
_READERS: dict[str, Callable[[Document, SourceText], AnyLoaded]] = {
    "climb": _loaded,
    "transition": transition_of_document,
    "bookshelf": shelf_of_document,
    "limms": limms_of,
    "mpc": mpc_of,
    "envelopes": envelopes_of,
    "program": program_of,
    "dataset": dataset_of,
    "strategy": strategy_of,
    "robot": lambda document, text: robot_of(document, text.directory),
    "module": lambda document, _: module_of(document),
}
