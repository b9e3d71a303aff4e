"""The user's own spec for `climbplan verify PLAN --spec SPEC`, beside the one in the plan."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from climbplan.errors import UsageError

if TYPE_CHECKING:
    from climbplan.schema.holding import HeldSpec


def held_against_own(path: Path, spec: str, assignments: Sequence[str] | None) -> HeldSpec:
    """The spec that a plan file is to be held against; paths in it start from its folder.

    Raises:
        UsageError: files of this kind are not made for one spec, or the spec is of another kind.
        SpecError: every mistake in the spec.
    """
    from climbplan.schema.loading import load_spec

    require_holdable(path, "--spec")
    return held_against(path, load_spec(spec, list(assignments or ())), f"--spec {spec}")


def require_holdable(path: Path, shown: str) -> str:
    """The kind of a plan file; raises UsageError for files that are not made for one spec."""
    from climbplan.schema.holding import RULES
    from climbplan.store.plan_format import plan_format

    kind = plan_format(path).partition("/")[2]
    if kind not in RULES:
        raise UsageError(f"{path}: a {kind}, which {shown} cannot be held against; plans can")
    return kind


def held_against(path: Path, loaded: object, shown: str) -> HeldSpec:
    """A loaded spec as a plan file is held against it; shown: the spec's name in messages.

    Raises UsageError where the plan is of another kind than the spec.
    """
    from climbplan.climb.scene.climb_scene import on_scan
    from climbplan.climb.schema.loading import LoadedClimb
    from climbplan.climb.schema.transition_loading import LoadedTransition
    from climbplan.schema.holding import held_spec
    from climbplan.schema.loaded import LoadedSpec
    from climbplan.store.spec_text import stored_spec_text

    kind = require_holdable(path, shown)
    own = str(vars(vars(loaded).get("spec", loaded))["kind"])
    if own != kind or not isinstance(loaded, LoadedSpec):
        raise UsageError(f"{shown}: a spec of kind `{own}`, and {path} is a `{kind}` plan")
    if isinstance(loaded, LoadedClimb):
        from climbplan.climb.planner.chaining import started

        loaded = on_scan(started(loaded))
    elif isinstance(loaded, LoadedTransition):
        loaded = on_scan(loaded)
    return held_spec(loaded, vars(loaded)["spec"], stored_spec_text(path))
