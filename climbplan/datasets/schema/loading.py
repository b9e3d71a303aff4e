"""From a dataset spec file and overrides to a validated model, with all mistakes at once."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from climbplan.climb.schema.envelopes_loading import find_unknown_limbs
from climbplan.datasets.schema.model import (
    BY_PROBLEM,
    AnyDatasetModel,
    AnyDatasetSpec,
    MotionsDatasetSpec,
    TerrainsDatasetSpec,
    WalksDatasetSpec,
)
from climbplan.datasets.schema.motions import (
    MODEL_ENDINGS,
    ROBOT_ENDINGS,
    MotionsProblemSpec,
    ScansSceneSpec,
    SpecSceneSpec,
)
from climbplan.errors import SpecError, SpecMistake
from climbplan.schema.document import Document, Finding, KeyPath
from climbplan.schema.fields import find_closest_name
from climbplan.schema.kinds import find_kind, validate
from climbplan.schema.loaded import LoadedSpec, describe_origin, resolve_option_paths
from climbplan.schema.overrides import Override, apply_overrides
from climbplan.schema.robots.named import load_robot_of_document
from climbplan.schema.robots.source import UnknownRobot, list_builtin_robots
from climbplan.schema.source import SourceText, read_source
from climbplan.schema.wording import format_value
from climbplan.schema.yaml_source import parse_yaml
from climbplan.walking.schema.loading import load_document_body

_PATHS = (
    ("problem", "solver", "library", "file"),
    ("problem", "solver", "library"),
    ("problem", "solver", "model", "file"),
)


@dataclass(frozen=True, kw_only=True)
class LoadedDataset(LoadedSpec):
    """A dataset spec and the text it came from."""

    spec: AnyDatasetSpec


def load_dataset(source: str | Path, overrides: Sequence[str | Override] = ()) -> LoadedDataset:
    """Read, override and check a dataset spec; `source` is a path or `-` for standard input.

    Raises:
        SpecError: with every mistake in spec and overrides.
    """
    text = read_source(source)
    return build_dataset_spec(apply_overrides(parse_yaml(text.text, text.shown), overrides), text)


def build_dataset_spec(document: Document, text: SourceText) -> LoadedDataset:
    """Return the dataset spec that a document describes.

    Raises:
        SpecError: with every mistake in it.
    """
    findings: list[Finding] = []
    kind = find_kind(document, expected_kind="dataset")
    if isinstance(kind, Finding):
        findings.append(kind)
    resolve_option_paths(document, _PATHS)
    model = _select_model(document)
    if isinstance(model, Finding):
        raise SpecError(document.source, document.mistakes([*findings, model]))
    spec, model_findings = validate(document, model)
    findings += [f for f in model_findings if f.path != ("kind",)]
    robot_mistakes: list[SpecMistake] = []
    if model is TerrainsDatasetSpec:
        path: KeyPath = ("problem", "robot")
        robot, robot_mistakes = load_robot_of_document(document, text.directory, path)
        if spec is not None and robot is not None and isinstance(spec, TerrainsDatasetSpec):
            findings += find_unknown_limbs(spec.problem.terrain, robot, ("problem", "terrain"))
    if isinstance(spec, MotionsDatasetSpec):
        findings += _find_missing_files(spec.problem, text.directory)
    mistakes = [*document.mistakes(findings), *robot_mistakes]
    if model is WalksDatasetSpec:
        mistakes += load_document_body(document, text.directory, ("problem", "robot"))[1]
    if spec is None or mistakes:
        raise SpecError(document.source, mistakes)
    return LoadedDataset(spec=spec, **describe_origin(document, text))


def _find_missing_files(problem: MotionsProblemSpec, directory: Path) -> list[Finding]:
    """Return findings for robots, specs and folders of motions that are not there."""
    findings = []
    for k, robot in enumerate(problem.robots):
        path: KeyPath = ("problem", "robots", k, "file")
        is_file = robot.file.lower().endswith((*MODEL_ENDINGS, *ROBOT_ENDINGS))
        if is_file and not (directory / robot.file).is_file():
            findings.append(Finding(path, f"no such file {robot.file!r}, expected a robot's"))
        elif not is_file and robot.file not in list_builtin_robots():
            unknown = UnknownRobot(robot.file)
            findings.append(Finding(path, str(unknown), unknown.suggestion))
    for k, scene in enumerate(problem.scenes):
        if isinstance(scene, SpecSceneSpec) and not (directory / scene.file).is_file():
            message = f"no such file {scene.file!r}, expected a spec that a robot moves by"
            findings.append(Finding(("problem", "scenes", k, "file"), message))
        elif isinstance(scene, ScansSceneSpec) and not (directory / scene.folder).is_dir():
            message = f"no such folder {scene.folder!r}, expected one with meshes"
            findings.append(Finding(("problem", "scenes", k, "folder"), message))
    return findings


def _select_model(document: Document) -> AnyDatasetModel | Finding:
    """Return the model that `problem.kind` asks for, or what is wrong with it."""
    kind_names = ", ".join(f"`{kind}`" for kind in BY_PROBLEM)
    problem = document.value.get("problem")
    if not isinstance(problem, dict):
        observed = "missing" if problem is None else f"got {format_value(problem)}"
        return Finding(
            ("problem",), f"{observed}, expected a mapping with a `kind` (one of {kind_names})"
        )
    kind = problem.get("kind")
    if not isinstance(kind, str) or kind not in BY_PROBLEM:
        closest = find_closest_name(kind, list(BY_PROBLEM)) if isinstance(kind, str) else None
        observed = "missing" if kind is None else f"got {format_value(kind)}"
        return Finding(("problem", "kind"), f"{observed}, expected one of {kind_names}", closest)
    return BY_PROBLEM[kind]
