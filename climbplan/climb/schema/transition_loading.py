"""Loading of transition specs with overrides, with all mistakes at once."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from climbplan.climb.schema.checks import ValidClimbParts, check_parts, check_risk
from climbplan.climb.schema.transition import TransitionSpec, TransitionTaskSpec
from climbplan.errors import SpecError
from climbplan.schema.document import Document, Finding
from climbplan.schema.kinds import validate_kind
from climbplan.schema.loaded import LoadedSpec, describe_origin, resolve_option_paths
from climbplan.schema.overrides import Override, apply_overrides
from climbplan.schema.robots.named import load_robot_of_document, validate_part
from climbplan.schema.robots.source import AnyRobot
from climbplan.schema.robots.stored import CarriedRobot
from climbplan.schema.source import SourceText, read_source
from climbplan.schema.terrain.terrain import TerrainSpec
from climbplan.schema.yaml_source import parse_yaml


@dataclass(frozen=True, kw_only=True)
class LoadedTransition(LoadedSpec):
    """A transition spec, checked against its robot, and the text it came from."""

    spec: TransitionSpec
    robot: AnyRobot
    carried_robot: CarriedRobot | None = None  # of a plan, which the robot is from; None: files

    def with_overrides(self, overrides: Sequence[str | Override]) -> LoadedTransition:
        """Return the same transition with other values.

        Raises:
            SpecError: Lists every mistake that the overrides cause.
        """
        text = SourceText(self.source, self.name, self.directory, self.text)
        return build_transition(apply_overrides(self.document, overrides), text, self.carried_robot)


def load_transition(
    source: str | Path, overrides: Sequence[str | Override] = ()
) -> LoadedTransition:
    """Read, override and check a transition spec and its robot; `-` is standard input.

    Raises:
        SpecError: Lists every mistake in spec, overrides and robot file.
    """
    return load_transition_text(read_source(source), overrides)


def load_transition_text(
    text: SourceText, overrides: Sequence[str | Override] = ()
) -> LoadedTransition:
    """Override and check a transition spec whose text was read already.

    Raises:
        SpecError: Lists every mistake in spec, overrides and robot file.
    """
    document = apply_overrides(parse_yaml(text.text, text.shown), overrides)
    return build_transition(document, text)


def load_planned_transition(text: str, name: str, carried_robot: CarriedRobot) -> LoadedTransition:
    """Check the spec of a plan, with the robot that the plan carries.

    Args:
        text: The spec that the plan carries.
        name: Of the plan.
        carried_robot: The robot that it carries.

    Raises:
        NotKept: The plan does not carry its robot, or a field is missing that meshes tell.
        SpecError: Lists every mistake.
    """
    source = SourceText(name, name, Path.cwd(), text)
    return build_transition(parse_yaml(text, name), source, carried_robot)


def build_transition(
    document: Document, text: SourceText, carried_robot: CarriedRobot | None = None
) -> LoadedTransition:
    """Build the loaded transition of a document.

    Raises:
        SpecError: Lists every mistake in it.
        NotKept: What is carried is not the whole robot.
    """
    resolve_option_paths(document, [("terrain", "scan", "file")])
    spec, findings = validate_kind(document, "transition", TransitionSpec)
    robot: AnyRobot | None
    if carried_robot is None:
        robot, robot_mistakes = load_robot_of_document(document, text.directory)
    else:
        robot, robot_mistakes = carried_robot.load(document), []
    task = validate_part(document, "task", TransitionTaskSpec)
    terrain = validate_part(document, "terrain", TerrainSpec)
    findings += check_parts(ValidClimbParts(terrain, task, None, None, robot))
    if task is not None and robot is not None:
        findings += _check_limb_count(task, robot)
    if spec is not None and spec.climb is not None and robot is not None:
        findings += _check_climb_gait(spec.climb.gait, robot)
    if spec is not None and robot is not None:
        findings += check_risk(spec, robot)
    if terrain is not None and terrain.tube is not None:
        findings.append(Finding(("terrain", "tube"), "expected flat surfaces in a transition"))
    mistakes = [*document.mistakes(findings), *robot_mistakes]
    if spec is None or robot is None or mistakes:
        raise SpecError(document.source, mistakes)
    origin = describe_origin(document, text)
    return LoadedTransition(spec=spec, robot=robot, carried_robot=carried_robot, **origin)


def _check_limb_count(task: TransitionTaskSpec, robot: AnyRobot) -> list[Finding]:
    """Check that some limb can move while enough others support the body."""
    count = len(robot.limb_names)
    max_moving = count - task.min_supporting_limbs
    if max_moving < 1:
        message = (
            f"{robot.name} has {count} limbs: with {task.min_supporting_limbs} supporting, "
            f"none can move (expected at most {count - 1})"
        )
        return [Finding(("task", "min_supporting_limbs"), message)]
    if task.moving and max(task.moving) > max_moving:
        message = (
            f"{max(task.moving)} of {count} limbs cannot move at once "
            f"while {task.min_supporting_limbs} support the body (`task.min_supporting_limbs`)"
        )
        return [Finding(("task", "sequence"), message)]
    return []


def _check_climb_gait(gait: tuple[str, ...] | None, robot: AnyRobot) -> list[Finding]:
    """Check that the climb's gait moves each limb once."""
    limbs = list(robot.limb_names)
    if gait is None or sorted(gait) == sorted(limbs):
        return []
    message = f"expected each limb once ({', '.join(limbs)}), got {', '.join(gait)}"
    return [Finding(("climb", "gait"), message)]
