"""Verify a plan against the user's own spec: `climbplan verify PLAN --spec SPEC`."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from climbplan.errors import UsageError

if TYPE_CHECKING:
    from climbplan.schema.holding import HeldSpec


def load_spec_to_verify(path: Path, spec: str, assignments: Sequence[str] | None) -> HeldSpec:
    """Load the spec that a plan file is verified against; its relative paths start from its folder.

    Raises:
        UsageError: files of this kind are not made from one spec, or the spec is of another kind.
        SpecError: the spec has mistakes; all of them are listed.
    """
    from climbplan.schema.loading import load_spec

    require_verifiable(path, "--spec")
    return match_spec_to_plan(path, load_spec(spec, list(assignments or ())), f"--spec {spec}")


def require_verifiable(path: Path, option: str) -> str:
    """Return the kind of a plan file; raises UsageError for files not made from one spec."""
    from climbplan.schema.holding import RULES
    from climbplan.store.plan_format import read_plan_format

    kind = read_plan_format(path).partition("/")[2]
    if kind not in RULES:
        raise UsageError(
            f"{path}: a {kind}, which cannot be verified against {option}; expected a plan"
        )
    return kind


def match_spec_to_plan(path: Path, loaded: object, option: str) -> HeldSpec:
    """Compare a loaded spec with the spec stored in a plan file.

    Args:
        path: the plan file.
        loaded: the user's spec.
        option: how the user gave the spec, for messages.

    Raises:
        UsageError: the plan is of another kind than the spec.
    """
    from climbplan.climb.scene.climb_scene import apply_scan
    from climbplan.climb.schema.loading import LoadedClimb
    from climbplan.climb.schema.transition_loading import LoadedTransition
    from climbplan.schema.holding import compare_specs
    from climbplan.schema.loaded import LoadedSpec
    from climbplan.store.spec_text import read_spec_text
    from climbplan.walking.schema.loading import LoadedMpc

    kind = require_verifiable(path, option)
    spec_kind = str(vars(vars(loaded).get("spec", loaded))["kind"])
    if spec_kind != kind or not isinstance(loaded, LoadedSpec):
        raise UsageError(f"{option}: a spec of kind `{spec_kind}`, and {path} is a `{kind}` plan")
    if isinstance(loaded, LoadedClimb):
        from climbplan.climb.planner.start_from_plan import resolve_start_plan

        loaded = apply_scan(resolve_start_plan(loaded))
    elif isinstance(loaded, LoadedTransition):
        loaded = apply_scan(loaded)
    elif isinstance(loaded, LoadedMpc) and loaded.spec.terrain.scan is not None:
        from climbplan.walking.problem.scanning import fit_walk_scan

        loaded = fit_walk_scan(loaded)
    return compare_specs(loaded, vars(loaded)["spec"], read_spec_text(path))
