"""Compare the spec that a plan carries with the one that its user wrote, key by key.

A plan may be held against another spec than the one that it carries. Then every key counts, except
those that say how a plan came about and not what it has to do (seed, method), and those that the
planner may choose where the user's spec leaves them out: for these the plan's own values are taken.
A key that the plan's checks judge anew may differ - a plan made for a larger safety factor is good
for a smaller one - and where no check looks at it, it may not.
"""

from __future__ import annotations

import copy
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

from climbplan.errors import SpecError
from climbplan.schema.base import SpecModel
from climbplan.schema.kinds import KINDS, validate
from climbplan.schema.loaded import LoadedSpec
from climbplan.schema.robots.source import AnyRobot
from climbplan.schema.wording import format_value
from climbplan.schema.yaml_source import parse_yaml, write_yaml

Role = Literal["how", "chosen", "judged", "held"]


@dataclass(frozen=True)
class Rules:
    """What the keys of one kind of spec are to a plan; dotted keys stand for all below them."""

    how: tuple[str, ...]  # how a plan comes about
    judged: tuple[str, ...]  # recomputed from the plan by its checks
    chosen: tuple[str, ...] = ()  # the planner's choice where a spec leaves them out

    def role(self, key: str, written: bool) -> Role:
        """Return what a key is to a plan; of several entries that match, the longest decides.

        Args:
            key: Dotted key.
            written: Whether the user's spec has the key.
        """
        if not written and _match_length(key, self.chosen):
            return "chosen"
        how, judged = _match_length(key, self.how), _match_length(key, self.judged)
        if max(how, judged) == 0:
            return "held"
        return "how" if how > judged else "judged"


_MOTION_JUDGED = (
    "robot",
    "terrain",
    "task",
    "posture.steps",
    "posture.weights",
    "posture.body_clearance",
    "force.safety_friction",
    "force.safety_torque",
    "force.min_normal_force",
    "force.min_penetration",
    "force.deflection_compensation",
    "trajectory.swing_clearance",
    "trajectory.rate",
)
_HOW = ("seed", "title", "solver")
# Open together: a goal whose angles are stated is not to be reached by any other angles.
_GOAL_ANGLES = ("task.goal.rpy_deg", "task.goal.rotation_tolerance_deg")
RULES = {
    "climb": Rules(
        how=(*_HOW, "study"),
        judged=(*_MOTION_JUDGED, "gripper"),
        chosen=("task.rounds", "task.gait", *_GOAL_ANGLES, "trajectory.swing_clearance"),
    ),
    "transition": Rules(
        how=(*_HOW, "search"),
        judged=(*_MOTION_JUDGED, "climb.rounds", "climb.gait", "climb.goal", "climb.posture.steps"),
        chosen=(
            "task.sequence",
            *_GOAL_ANGLES,
            "climb.rounds",
            "climb.gait",
            "climb.goal.rpy_deg",
            "trajectory.swing_clearance",
        ),
    ),
    "mpc": Rules(how=(*_HOW, "library"), judged=("robot", "terrain", "task", "weights")),
    "limms": Rules(
        how=_HOW, judged=("robot", "box", "boxes", "static_boxes", "modules", "terrain")
    ),
    "bookshelf": Rules(
        how=_HOW,
        judged=("shelf", "scene", "scenes", "formulation", "solver.gap", "solver.gap_mm2"),
    ),
    "program": Rules(how=_HOW, judged=("solver.gap", "solver.tolerance")),
}
"""By kind of spec; a plan of any other kind cannot be held against a spec."""
OPEN = "auto"  # value of a key that leaves it to the planner, as if it were not written


@dataclass(frozen=True)
class KeyDifference:
    """A key in which the plan's spec differs from the user's."""

    key: str
    plan: Any
    own: Any
    role: Role

    def __str__(self) -> str:
        role_note = {
            "how": " (how the plan came about)",
            "chosen": " (left out: the planner's choice)",
            "judged": "",
            "held": "",
        }[self.role]
        values = f"plan's spec {_format_value(self.plan)}, yours {_format_value(self.own)}"
        return f"{self.key}: {values}{role_note}"

    def as_dict(self) -> dict[str, Any]:
        """Return plain values for JSON."""
        return {"key": self.key, "plan": self.plan, "spec": self.own, "role": self.role}


@dataclass(frozen=True)
class HeldSpec:
    """A user's spec as a plan is held against it."""

    source: str  # as in messages: "specs/climb_obstacle.yaml"
    sha256: str  # of the user's text, after overrides
    text: str  # the user's spec with the plan's values where those are taken
    differences: tuple[KeyDifference, ...]
    directory: Path  # that paths in it start from
    robot: AnyRobot | None = None  # of climbs and transitions
    robot_text: str = ""  # of walks: the text of the robot's file, empty for a built-in one
    robot_urdf: str = ""  # and of the URDF that it names, if it does
    module_text: str = ""  # of module plans, likewise
    kind: str = field(default="")

    @property
    def broken(self) -> tuple[KeyDifference, ...]:
        """Differences in keys that no check judges anew."""
        return tuple(d for d in self.differences if d.role == "held")


def compare_specs(loaded: LoadedSpec, spec: SpecModel, plan_text: str) -> HeldSpec:
    """Compare the user's loaded spec with the spec that a plan carries.

    Args:
        loaded: The user's spec with its document, which says what it states.
        spec: Its model.
        plan_text: YAML text of the plan's spec. Text that is no spec of the kind differs in `kind`.

    Returns:
        The user's spec with what differs, and the text that checks of the plan have to use: keys
        that a spec leaves to the planner have the plan's values there.
    """
    kind = str(vars(spec)["kind"])
    rules = RULES[kind]
    written = copy.deepcopy(loaded.document.value)
    differences: list[KeyDifference] = []
    stored = _parse_stored(plan_text, kind)
    if stored is None:
        differences.append(KeyDifference("kind", "no such spec", kind, "held"))
    else:
        user_values = spec.model_dump(mode="json")
        for key, plan_value, user_value in _find_differences(
            "", stored.model_dump(mode="json"), user_values
        ):
            together = _GOAL_ANGLES if key in _GOAL_ANGLES else (key,)
            stated = (
                any(_has_key(loaded.document.value, name) for name in together)
                and user_value != OPEN
            )
            role = rules.role(key, stated)
            differences.append(KeyDifference(key, plan_value, user_value, role))
            if role in ("how", "chosen"):
                _set_value(written, key, plan_value)
    return HeldSpec(
        source=loaded.source,
        sha256=loaded.sha256,
        text=write_yaml(written),
        differences=tuple(differences),
        directory=loaded.directory,
        kind=kind,
        **{
            name: vars(loaded)[name]
            for name in ("robot", "robot_text", "robot_urdf", "module_text")
            if name in vars(loaded) and (name != "robot" or kind in ("climb", "transition"))
        },
    )


def _parse_stored(text: str, kind: str) -> SpecModel | None:
    try:
        return validate(parse_yaml(text, "spec"), KINDS[kind].model)[0]
    except SpecError:
        return None


def _find_differences(key: str, stored: Any, user: Any) -> Iterator[tuple[str, Any, Any]]:
    """Yield keys whose values differ; a list counts as a whole where its length differs."""
    if isinstance(stored, Mapping) and isinstance(user, Mapping):
        for name in dict.fromkeys([*stored, *user]):
            below = f"{key}.{name}" if key else str(name)
            yield from _find_differences(below, stored.get(name), user.get(name))
    elif _has_parts(stored) and _has_parts(user) and len(stored) == len(user):
        for number, (stored_entry, user_entry) in enumerate(zip(stored, user, strict=True)):
            yield from _find_differences(f"{key}.{number}", stored_entry, user_entry)
    elif stored != user:
        yield key, stored, user


def _has_parts(value: Any) -> bool:
    return isinstance(value, list) and any(isinstance(entry, dict) for entry in value)


def _has_key(value: Any, key: str) -> bool:
    """Return whether a document says something at a key or on the way to it."""
    for name in key.split("."):
        if isinstance(value, list):
            return True
        if not isinstance(value, dict):
            return value is not None
        if name not in value:
            return False
        value = value[name]
    return True


def _set_value(value: dict[str, Any], key: str, new: Any) -> None:
    """Write a value, or take the key away where there is none."""
    *parents, last = key.split(".")
    for name in parents:
        if not isinstance(value.get(name), dict):
            value[name] = {}
        value = value[name]
    if new is None:
        value.pop(last, None)
    else:
        value[last] = new


def _match_length(key: str, entries: tuple[str, ...]) -> int:
    """Return length of the longest entry that stands for a key, 0 for none."""
    return max((len(e) for e in entries if key == e or key.startswith(f"{e}.")), default=0)


def _format_value(value: Any) -> str:
    return f"{value:g}" if isinstance(value, float) else format_value(value)
