"""Loading of specs of kind `envelopes` with overrides."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from climbplan.climb.schema.envelopes import EnvelopesSpec, EnvelopeTerrainSpec
from climbplan.errors import SpecError
from climbplan.schema.document import Document, Finding, KeyPath
from climbplan.schema.fields import find_closest_name
from climbplan.schema.kinds import validate_kind
from climbplan.schema.loaded import LoadedSpec, describe_origin, resolve_option_paths
from climbplan.schema.overrides import Override, apply_overrides
from climbplan.schema.robots.named import load_robot_of_document
from climbplan.schema.robots.source import AnyRobot
from climbplan.schema.source import SourceText, read_source
from climbplan.schema.yaml_source import parse_yaml


@dataclass(frozen=True, kw_only=True)
class LoadedEnvelopes(LoadedSpec):
    """An envelopes spec and the text it came from."""

    spec: EnvelopesSpec


def load_envelopes(source: str | Path, overrides: Sequence[str | Override] = ()) -> LoadedEnvelopes:
    """Read, override and check a spec; `source` is a path or `-` for standard input.

    Raises:
        SpecError: Lists every mistake in spec and overrides.
    """
    text = read_source(source)
    return build_envelopes(apply_overrides(parse_yaml(text.text, text.shown), overrides), text)


def build_envelopes(document: Document, text: SourceText) -> LoadedEnvelopes:
    """Build the envelopes spec of a document.

    Raises:
        SpecError: Lists every mistake in it.
    """
    resolve_option_paths(document, (("data", "dataset"),))
    spec, findings = validate_kind(document, "envelopes", EnvelopesSpec)
    robot, robot_mistakes = load_robot_of_document(document, text.directory)
    if spec is not None and robot is not None:
        findings = [*findings, *find_unknown_limbs(spec.terrain, robot, ("terrain",))]
    mistakes = [*document.mistakes(findings), *robot_mistakes]
    if spec is None or mistakes:
        raise SpecError(document.source, mistakes)
    return LoadedEnvelopes(spec=spec, **describe_origin(document, text))


def find_unknown_limbs(spec: EnvelopeTerrainSpec, robot: AnyRobot, path: KeyPath) -> list[Finding]:
    """Return findings for limbs that a section at `path` names and the robot does not have."""
    limbs = list(robot.limb_names)
    return [
        Finding(
            (*path, *key),
            f"{robot.name} has no limb {name!r}, its limbs are {', '.join(limbs)}",
            find_closest_name(name, limbs),
        )
        for key, name in spec.named_limbs
        if name not in limbs
    ]
