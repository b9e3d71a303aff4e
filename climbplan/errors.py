"""The exceptions of the package, one for each way a run can end without a verified plan.

Each carries the exit code that the command line gives it (see docs/command_line.md).
"""

from __future__ import annotations

import shlex
from collections.abc import Sequence
from dataclasses import dataclass
from enum import IntEnum

from climbplan.deprecation import warn_renamed


class ExitCode(IntEnum):
    """Exit codes of every command."""

    OK = 0
    INTERNAL = 1
    USAGE = 2
    INFEASIBLE = 3
    LIMIT = 4
    UNVERIFIED = 5


class ClimbplanError(Exception):
    """Root of all errors that are not bugs."""

    exit_code: ExitCode = ExitCode.USAGE


@dataclass(frozen=True)
class SpecMistake:
    """One mistake in a spec: where it stands and what was expected there."""

    key: str  # dotted path, "" for the whole document
    message: str  # what is wrong and what was expected
    line: int | None = None  # 1-based line in the file
    suggestion: str | None = None  # nearest valid key
    source: str | None = None  # file or command option, where it is not the spec itself


class SpecError(ClimbplanError):
    """A spec that cannot be used; carries every mistake found, not just the first."""

    def __init__(self, source: str, mistakes: list[SpecMistake]) -> None:
        self.source = source
        self.mistakes = mistakes
        super().__init__("\n".join(self._line(m) for m in mistakes))

    def _line(self, mistake: SpecMistake) -> str:
        where = mistake.source or self.source
        where = f"{where}:{mistake.line}" if mistake.line else where
        key = f"{mistake.key}: " if mistake.key else ""
        hint = f" (did you mean {mistake.suggestion!r}?)" if mistake.suggestion else ""
        return f"{where}: {key}{mistake.message}{hint}"


class UsageError(ClimbplanError):
    """A command that cannot be carried out as given (paths, options, file formats)."""


class PlanFileError(UsageError):
    """A file that is not a plan, or a plan that is damaged."""


class UnsoundPlan(ClimbplanError):
    """A plan whose verification could not get past its data: nothing else can be made of it."""

    exit_code = ExitCode.UNVERIFIED


class VerificationFailed(ClimbplanError):
    """A plan that does not do what it says, as where the simulated robot falls.

    plan: the plan itself, where it was made in Python (`climbplan.plan`).
    """

    exit_code = ExitCode.UNVERIFIED
    plan: object = None


class MissingSolver(UsageError):
    """A solver or library that is not installed; says how to install it."""


@dataclass(frozen=True)
class Remedy:
    """A change that makes an infeasible problem feasible, as far as the failed stage can tell.

    `--set key=value` makes the change where it is one of a spec key.
    """

    words: str  # "mu >= 0.83"
    key: str = ""  # dotted key of the spec, "" where none stands for the change (more motors)
    value: float | int | str | tuple[float, ...] | None = None

    def __str__(self) -> str:
        return f"{self.words} ({self.option})" if self.key else self.words

    @property
    def option(self) -> str:
        """The change as an option of the command line; "" if it is none of a spec key."""
        if not self.key:
            return ""
        return f"--set {shlex.quote(f'{self.key}={self.yaml}')}"

    @property
    def yaml(self) -> str:
        """The value as YAML."""
        if isinstance(self.value, tuple):
            return f"[{', '.join(_number(v) for v in self.value)}]"
        return _number(self.value)

    def as_dict(self) -> dict[str, object]:
        """Return plain values for `--json`."""
        value = list(self.value) if isinstance(self.value, tuple) else self.value
        return {"key": self.key, "value": value, "words": self.words}


def _number(value: object) -> str:
    return f"{value:.10g}" if isinstance(value, float) else str(value)  # not to a worse value


@dataclass(frozen=True)
class Conflict:
    """Constraints that cannot hold together, in the robot's terms."""

    where: str  # "round 3, LM lifted"
    constraints: tuple[str, ...]  # ("friction at RF", "torque of LR femur")
    remedies: tuple[Remedy, ...] = ()  # each enough on its own
    in_words: bool = False  # the constraints already say how they fail
    enough: bool = True  # else each remedy is needed at least, and was not planned with
    tried: bool = False  # remedies are enough for the motion that was tried; others may need less
    names: tuple[str, ...] = ()  # of the checks that judge them: one a constraint, or of all words

    def __str__(self) -> str:
        what = " and ".join(self._constraints_with_checks())
        verb = " conflict" if len(self.constraints) > 1 else " cannot be met"
        if self.in_words:
            verb = ""
        cure = f"; {self.remedy_lead} {' or '.join(map(str, self.remedies))}"
        return f"{self.where}: {what}{verb}{cure if self.remedies else ''}"

    @property
    def remedy_lead(self) -> str:
        """Return the words before the remedies, which say how much they promise."""
        if self.tried:
            return "what was tried is feasible with"
        return "feasible with" if self.enough else "at least needed:"

    def _constraints_with_checks(self) -> tuple[str, ...]:
        """The constraints, each with the name of its check in brackets."""
        if self.in_words or not self.names:
            checks_text = f" [{', '.join(self.names)}]" if self.names else ""
            return (*self.constraints[:-1], self.constraints[-1] + checks_text)
        both = zip(self.constraints, self.names, strict=True)
        return tuple(what if what == name else f"{what} [{name}]" for what, name in both)


_MIN_LINES_FOR_CHANGE = 3  # lines of a failure whose first one also names a change


class NoPlanFound(ClimbplanError):
    """No plan exists or none was found within the limits.

    Its text begins with one sentence that says what failed. Where the text has several lines, that
    sentence also names the nearest change of the spec that helps, if one is known.

    stage: where it ended ("posture", "force", ...). remedies: beside those of the conflicts.
    partial: what was planned of the way to the goal before the search ended, if anything.
    `climbplan.plan` makes it a plan.
    """

    exit_code = ExitCode.LIMIT
    status = "limit"  # as `--json` reports it
    partial: object = None

    def __init__(
        self,
        message: str,
        conflicts: Sequence[Conflict] | None = None,
        *,
        stage: str = "",
        remedies: Sequence[Remedy] = (),
    ) -> None:
        self.message = message
        self.conflicts = list(conflicts or [])
        self.stage = stage
        self._remedies = tuple(remedies)
        super().__init__("\n".join([self._headline(), *(str(c) for c in self.conflicts)]))

    def _headline(self) -> str:
        """Return the message, its first line with the nearest change if many lines follow it."""
        num_lines = self.message.count("\n") + 1 + len(self.conflicts)
        first, newline, details = self.message.partition("\n")
        if num_lines < _MIN_LINES_FOR_CHANGE or "--set" in first:
            return self.message
        if nearest := next((c for c in self.conflicts if c.remedies), None):
            change = f"; nearest: {nearest.where}, {nearest.remedy_lead} {nearest.remedies[0]}"
        elif self._remedies:
            change = f"; a change to try: {self._remedies[0]}"
        else:
            return self.message
        colon = ":" if first.endswith(":") else ""
        return f"{first.removesuffix(':')}{change}{colon}{newline}{details}"

    @property
    def remedies(self) -> tuple[Remedy, ...]:
        """All that are known, without repetition."""
        every = [*self._remedies, *(r for c in self.conflicts for r in c.remedies)]
        return tuple(dict.fromkeys(every))


class Infeasible(NoPlanFound):
    """The problem that the user stated is proved to have no solution; names what conflicts."""

    exit_code = ExitCode.INFEASIBLE
    status = "infeasible"


class Unresolved(NoPlanFound):
    """A method found no plan within restrictions of its own, which proves nothing.

    because: the restrictions, for people ("rotations linearised, workspaces as balls").
    """

    status = "not_proved"

    def __init__(
        self,
        message: str,
        conflicts: Sequence[Conflict] | None = None,
        *,
        because: str,
        stage: str = "",
        remedies: Sequence[Remedy] = (),
    ) -> None:
        super().__init__(message, conflicts, stage=stage, remedies=remedies)
        self.because = because

    def __str__(self) -> str:
        return f"{super().__str__()}\nnot proved: {self.because}"


class LimitReached(NoPlanFound):
    """A time or iteration limit was hit before any plan was found."""


class ReachFailure(NoPlanFound):
    """A toe that a limb cannot reach within its joint bounds, in a posture that somebody chose."""

    status = "not_proved"

    def __init__(
        self,
        limb: str,
        reason: str,
        missing: float = 0.0,
        where: str = "",
        joint: int | None = None,
        past: float = 0.0,
    ) -> None:
        self.limb = limb
        self.reason = reason  # "too far", "too near", "femur bound", ...
        self.missing = missing  # [m] out of reach by this much; 0 if only joint bounds fail
        self.joint, self.past = joint, past  # the joint past its bound if known, and how far [rad]
        self.where = where  # "round 3, LM lifted"
        prefix = f"{where}: " if where else ""
        gap = f" by {1e3 * missing:.1f} mm" if missing > 0 else ""
        text = f"{prefix}{limb} cannot reach its toe: {reason}{gap}"
        super().__init__(text, stage="kinematics")


# Old names of these errors, which user code may still catch
_RENAMED = {"NotProved": "Unresolved", "PlanFails": "VerificationFailed"}


def __getattr__(name: str) -> type[ClimbplanError]:
    """Return an error under its old name, with a warning that gives the new one."""
    if name not in _RENAMED:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    warn_renamed(f"`{__name__}.{name}`", f"`{__name__}.{_RENAMED[name]}`")
    error: type[ClimbplanError] = globals()[_RENAMED[name]]
    return error
