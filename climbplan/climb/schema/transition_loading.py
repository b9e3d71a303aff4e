"""From a transition spec file and overrides to a validated model, with all mistakes at once."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from climbplan.climb.schema.checks import ClimbParts, check_parts
from climbplan.climb.schema.transition import TransitionSpec, TransitionTaskSpec
from climbplan.errors import SpecError
from climbplan.schema.document import Document, Finding
from climbplan.schema.kinds import validate_kind
from climbplan.schema.loaded import LoadedSpec, origin_of, root_paths
from climbplan.schema.overrides import Override, apply_overrides
from climbplan.schema.robots.named import any_robot_of_document, part_of
from climbplan.schema.robots.source import AnyRobot
from climbplan.schema.source import SourceText, read_source
from climbplan.schema.terrain.terrain import TerrainSpec
from climbplan.schema.yaml_source import parse_yaml


@dataclass(frozen=True, kw_only=True)
class LoadedTransition(LoadedSpec):
    """A transition spec, checked against its robot, and the text it came from."""

    spec: TransitionSpec
    robot: AnyRobot

    def with_overrides(self, overrides: Sequence[str | Override]) -> LoadedTransition:
        """The same transition with other values.

        Raises:
            SpecError: with every mistake that the overrides bring.
        """
        text = SourceText(self.source, self.name, self.directory, self.text)
        return transition_of_document(apply_overrides(self.document, overrides), text)


def load_transition(
    source: str | Path, overrides: Sequence[str | Override] = ()
) -> LoadedTransition:
    """Read, override and check a transition spec and its robot; `-` is standard input.

    Raises:
        SpecError: with every mistake in spec, overrides and robot file.
    """
    return transition_of_text(read_source(source), overrides)


def transition_of_text(
    text: SourceText, overrides: Sequence[str | Override] = ()
) -> LoadedTransition:
    """As `load_transition`, of a text that was read already."""
    document = apply_overrides(parse_yaml(text.text, text.shown), overrides)
    return transition_of_document(document, text)


def transition_of_document(document: Document, text: SourceText) -> LoadedTransition:
    """The transition spec that a document is.

    Raises:
        SpecError: with every mistake in it.
    """
    root_paths(document, [("terrain", "scan", "file")])
    spec, findings = validate_kind(document, "transition", TransitionSpec)
    robot, robot_mistakes = any_robot_of_document(document, text.directory)
    task = part_of(document, "task", TransitionTaskSpec)
    terrain = part_of(document, "terrain", TerrainSpec)
    findings += check_parts(ClimbParts(terrain, task, None, None, robot))
    if task is not None and robot is not None:
        findings += _too_few_limbs(task, robot)
    if spec is not None and spec.climb is not None and robot is not None:
        findings += _gait_of_climb(spec.climb.gait, robot)
    if terrain is not None and terrain.tube is not None:
        findings.append(Finding(("terrain", "tube"), "expected flat surfaces in a transition"))
    mistakes = [*document.mistakes(findings), *robot_mistakes]
    if spec is None or robot is None or mistakes:
        raise SpecError(document.source, mistakes)
    return LoadedTransition(spec=spec, robot=robot, **origin_of(document, text))


def _too_few_limbs(task: TransitionTaskSpec, robot: AnyRobot) -> list[Finding]:
    """Some limb can move while enough others support the body."""
    count = len(robot.limb_names)
    most = count - task.supporting
    if most < 1:
        message = (
            f"{robot.name} has {count} limbs: with {task.supporting} supporting, none can move "
            f"(expected at most {count - 1})"
        )
        return [Finding(("task", "supporting"), message)]
    if task.moving and max(task.moving) > most:
        message = (
            f"{max(task.moving)} of {count} limbs cannot move at once while {task.supporting} "
            f"support the body (`task.supporting`)"
        )
        return [Finding(("task", "sequence"), message)]
    return []


def _gait_of_climb(gait: tuple[str, ...] | None, robot: AnyRobot) -> list[Finding]:
    """The climb's gait moves each limb once."""
    limbs = list(robot.limb_names)
    if gait is None or sorted(gait) == sorted(limbs):
        return []
    message = f"expected each limb once ({', '.join(limbs)}), got {', '.join(gait)}"
    return [Finding(("climb", "gait"), message)]
