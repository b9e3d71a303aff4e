"""From a climb's file and overrides to its validated model and robot, with all mistakes at once."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from climbplan.climb.schema.checks import ClimbParts, check_parts, check_study
from climbplan.climb.schema.model import ClimbSpec, PosturePlannerSpec, SolverSpec, TaskSpec
from climbplan.errors import SpecError
from climbplan.schema.document import Document
from climbplan.schema.kinds import validate_kind
from climbplan.schema.loaded import LoadedSpec, origin_of, root_paths
from climbplan.schema.overrides import Override, apply_overrides
from climbplan.schema.robots.named import any_robot_of_document, part_of
from climbplan.schema.robots.source import AnyRobot
from climbplan.schema.source import SourceText, read_source
from climbplan.schema.terrain.terrain import TerrainSpec
from climbplan.schema.yaml_source import parse_yaml


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
        return climb_of_document(apply_overrides(self.document, overrides), text)


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


def load_text(text: str, name: str, overrides: Sequence[str | Override] = ()) -> LoadedClimb:
    """Check a climb spec given as text; a robot's path starts from the current directory.

    Raises:
        SpecError: with every mistake in spec, overrides and robot file.
    """
    return _load(SourceText(name, name, Path.cwd(), text), overrides)


def _load(text: SourceText, overrides: Sequence[str | Override]) -> LoadedClimb:
    return climb_of_document(apply_overrides(parse_yaml(text.text, text.shown), overrides), text)


def climb_of_document(document: Document, text: SourceText) -> LoadedClimb:
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
