"""Old names of the Python interface, which keep working and say what replaced them."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Collection, Mapping
from functools import wraps
from typing import Any, ParamSpec, TypeVar

_P = ParamSpec("_P")
_T = TypeVar("_T")


def warn_renamed(old: str, new: str, stacklevel: int = 3) -> None:
    """Warn that the user's code has an old name; `stacklevel` as of `warnings.warn`."""
    warnings.warn(f"{old} is now {new}", FutureWarning, stacklevel=stacklevel)


def renamed_parameters(**renamed: str) -> Callable[[Callable[_P, _T]], Callable[_P, _T]]:
    """Let a function take old keyword names, given as `old="new"`, with a warning for each.

    The decorated function raises TypeError where old and new name of one parameter are both given.
    """

    def decorate(function: Callable[_P, _T]) -> Callable[_P, _T]:
        @wraps(function)
        def call(*arguments: _P.args, **keywords: _P.kwargs) -> _T:
            for old, new in renamed.items():
                if old in keywords:
                    if new in keywords:
                        raise TypeError(f"`{old}` is the old name of `{new}`: give one of them")
                    warn_renamed(f"the parameter `{old}`", f"`{new}`")
                    keywords[new] = keywords.pop(old)
            return function(*arguments, **keywords)

        return call

    return decorate


RENAMED_CHECKS: Mapping[str, str] = {
    "clear.box": "box.collision",
    "clear.boxes": "limbs.box_collision",
    "clear.modules": "limbs.module_collision",
    "clear.self": "limbs.self_collision",
    "clear.solids": "limbs.collision",
    "box.motion": "box.kinematics",
    "dynamics.spin": "dynamics.angular_velocity",
    "file.bound": "solution.bound",
    "file.optimal": "solution.gap",
    "force.inward": "force.penetration",
    "force.lifted_unloaded": "force.without_contact",
    "force.swing": "force.without_contact",
    "force.unattached": "force.without_contact",
    "goal.reached": "goal.position",
    "goal.turned": "goal.rotation",
    "grip.press": "grip.unilateral",
    "ground.free": "ground.support",
    "ground.stand": "ground.contact",
    "joint.range": "kinematics.joint_bounds",
    "joint.rates": "kinematics.joint_velocity",
    "joint.speed": "speed.limit",
    "kinematics.points": "kinematics.forward",
    "kinematics.toes": "kinematics.forward",
    "limbs.capsules": "limbs.collision",
    "limbs.clearance": "limbs.axis_collision",
    "load.ground": "load.friction",
    "load.tip": "load.tipping",
    "objective": "file.objective",
    "robust.pressure": "robust.normal_force",
    "samples.continuous": "trajectory.continuity",
    "samples.rate": "trajectory.rate",
    "solution.objective": "file.objective",
    "solution.rows": "solution.consistency",
    "spec.held": "spec.differences",
    "stiffness.command": "stiffness.toe_command",
    "stiffness.relation": "stiffness.force_deflection",
    "swing.ground": "swing.penetration",
    "swing.height": "swing.clearance",
    "torque.from_angles": "torque.from_forces",
    "torque.reach": "stance.reach",
    "trajectory.capsules": "trajectory.collision",
    "trajectory.clearance": "trajectory.axis_collision",
    "trajectory.ends": "trajectory.endpoints",
    "trajectory.grip": "trajectory.grip_shear",
    "trajectory.gripping": "trajectory.grip_force",
    "trajectory.joint_speed": "speed.limit",
    "workspace.whole_stance": "workspace.over_stance",
    "wrist.square": "wrist.alignment",
}
"""Old names of checks, and of the blocks of programs that state the same, with the new ones."""


RENAMED_METHODS: Mapping[str, Mapping[str, str]] = {
    "bookshelf": {"convex": "pinned", "micp": "mccormick"},
    "climb": {"coupled-micp": "coupled-mccormick", "spatial": "coupled-minlp-scip"},
    "limms": {"modes": "mode-search"},
    "mpc": {"micp": "spatial-branch-and-bound", "nlp": "mpcc", "search": "gait-search"},
    "program": {"micp": "mccormick"},
    "transition": {"complementarity": "mpcc", "enumerate": "stance-search"},
}
"""By kind of spec: old names of methods, with the new ones."""


def current_method_name(kind: str, name: str, stacklevel: int | None = None) -> str:
    """Return the name that a method has now; a name without a new one stays.

    Args:
        kind: Kind of spec, such as "climb".
        name: Name of the method, old or new.
        stacklevel: Level of the user's code, as `warnings.warn` counts it from `warn_renamed`;
            None gives no warning, for names that files of earlier versions hold.
    """
    new = RENAMED_METHODS.get(kind, {}).get(name)
    if new is None:
        return name
    if stacklevel is not None:
        warn_renamed(f"the method `{name}`", f"`{new}`", stacklevel)
    return new


def current_check_name(name: str, names: Collection[str], stacklevel: int = 4) -> str:
    """Return the name under which a check or block is known, with a warning for an old one.

    Args:
        name: Name as the user wrote it, old or new.
        names: Names that exist; one that is among them is never translated.
        stacklevel: Level of the user's code, as `warnings.warn` counts it from `warn_renamed`.
    """
    new = RENAMED_CHECKS.get(name)
    if name in names or new is None or new not in names:
        return name
    warn_renamed(f"the check `{name}`", f"`{new}`", stacklevel)
    return new


class RenamedAttribute:
    """An attribute or method of a class under its old name; reading it warns."""

    def __init__(self, new: str) -> None:
        self._new = new

    def __set_name__(self, owner: type, name: str) -> None:
        self._old_label = f"{owner.__name__}.{name}"
        self._new_label = f"{owner.__name__}.{self._new}"

    def __get__(self, instance: object, owner: type) -> Any:
        """Return what the new name gives; the class itself has the same without a warning."""
        if instance is None:
            return getattr(owner, self._new)
        warn_renamed(f"`{self._old_label}`", f"`{self._new_label}`")
        return getattr(instance, self._new)
