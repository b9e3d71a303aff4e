"""What loading climbs and transitions shares: the robot they name, and parts valid on their own."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import TypeVar

from pydantic import ValidationError

from climbplan.errors import SpecError, SpecMistake
from climbplan.schema.base import SpecModel
from climbplan.schema.document import Document, Finding, KeyPath
from climbplan.schema.robots.source import AnyRobot, UnknownRobot, load_any_robot
from climbplan.schema.robots.urdf.model import UrdfRobotSpec

Model = TypeVar("Model", bound=SpecModel)


def load_robot_of_document(
    document: Document, directory: Path, path: KeyPath = ("robot",)
) -> tuple[AnyRobot | None, list[SpecMistake]]:
    """Return the robot that a document names or holds, or what is wrong with it or its files.

    Args:
        document: A parsed spec.
        directory: Directory that paths in the spec start from.
        path: Keys down to the robot's name, path or mapping.

    Returns:
        The robot, None if there is none; and the mistakes, without those that the spec's own model
        reports.
    """
    reference = document.value
    for key in path:
        reference = reference.get(key) if isinstance(reference, dict) else None
    if isinstance(reference, dict):
        try:
            spec = UrdfRobotSpec.model_validate(reference)
        except ValidationError:
            return None, []  # reported with the whole
        from climbplan.schema.robots.urdf.source import build_urdf_robot

        robot, findings = build_urdf_robot(spec, document, path, directory)
        return robot, [document.mistake(finding) for finding in findings]
    if not isinstance(reference, str) or not reference:
        return None, []  # the model says what is wrong with it
    try:
        return load_any_robot(reference, directory), []
    except UnknownRobot as error:
        finding = Finding(path, str(error), error.suggestion)
        return None, [document.mistake(finding)]
    except SpecError as error:
        return None, [
            # Without a line the file itself is at fault, and so the key that names it.
            replace(m, source=m.source or error.source)
            if m.line
            else document.mistake(Finding(path, f"{error.source}: {m.message}", m.suggestion))
            for m in error.mistakes
        ]


def validate_part(document: Document, key: str, model: type[Model]) -> Model | None:
    """Validate one part of a document alone; return None if it is not valid.

    Args:
        document: A parsed spec, a mapping.
        key: Key of the part at the top level; a missing part is validated as an empty mapping.
        model: Model of the part.
    """
    try:
        return model.model_validate(document.value.get(key, {}))
    except ValidationError:
        return None  # reported with the whole
