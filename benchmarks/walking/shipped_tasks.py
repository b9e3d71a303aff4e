"""Tasks of the shipped specs."""

from __future__ import annotations

from pathlib import Path

from climbplan.schema.document import Document
from climbplan.schema.examples import read_example
from climbplan.schema.overrides import apply_overrides
from climbplan.schema.source import SourceText
from climbplan.schema.yaml_source import parse_yaml
from climbplan.walking.problem.problem import build_task
from climbplan.walking.schema.loading import LoadedMpc, validate_mpc
from climbplan.walking.task.task import WalkTask

FORMS = {
    "published": ("task.integrator=euler", "task.workspace_over_stance=false"),
    "mean": ("task.integrator=mean", "task.workspace_over_stance=false"),
    "shipped": (),
}
"""Euler steps and workspaces at knots; mean steps; and with them workspaces until toes lift."""
TASKS = ("mpc_forward", "mpc_disturbance", "mpc_turn", "mpc_stairs")


def shipped(name: str, *assignments: str) -> LoadedMpc:
    """A shipped spec of kind `mpc`, with assignments as of `--set`."""
    text = SourceText(name, name, Path.cwd(), read_example(name))
    document: Document = apply_overrides(parse_yaml(text.text, text.shown), assignments)
    return validate_mpc(document, text)


def shipped_task(name: str, *assignments: str) -> WalkTask:
    """Its task."""
    loaded = shipped(name, *assignments)
    return build_task(loaded.spec, loaded.robot, loaded.source)
