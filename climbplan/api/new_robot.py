"""Files for a robot from its URDF alone: the robot, a walk and a climb that plan as they are."""

from __future__ import annotations

import re
import tempfile
from collections.abc import Callable
from dataclasses import dataclass
from importlib.metadata import PackageNotFoundError, distribution
from pathlib import Path

from climbplan.api.planning import plan
from climbplan.errors import NoPlanFound, PlanFails, SpecError, UsageError
from climbplan.reports.robot_page import robot_page
from climbplan.robots.urdf.proposal.document import (
    chimney_document,
    ground_document,
    paths,
    robot_document,
)
from climbplan.robots.urdf.proposal.postures import Posture
from climbplan.robots.urdf.proposal.proposing import Proposal, propose

_TRIED = 8  # bracing postures that are planned with
_LIMIT = 20.0  # [s] for each plan


@dataclass(frozen=True)
class NewRobot:
    """Files by name, and what there is to say of them."""

    name: str
    files: dict[str, str]
    notes: tuple[str, ...]


def new_robot(
    urdf: Path, directory: Path, report: Callable[[str], None] = lambda words: None
) -> NewRobot:
    """Propose a robot from a URDF, and plan with it; paths in the files are for `directory`.

    A spec that does not lead to a plan is written all the same, and told. Raises SpecError for what
    is wrong in the URDF and UsageError where no robot can be proposed.
    """
    report("proposing legs, toes and postures")
    found = propose(urdf)
    name = _file_name(found.name)
    robot_file, ground, chimney = (f"{name}{end}.yaml" for end in ("", "_ground", "_chimney"))
    files = {robot_file: robot_document(found, paths(found, directory), f"{ground}, {chimney}")}
    absolute = robot_document(found, str(found.draft.urdf), "")
    with tempfile.TemporaryDirectory() as folder:
        place = Path(folder)
        (place / robot_file).write_text(absolute, encoding="utf-8")
        files[ground] = ground_document(found, robot_file)
        report("planning a walk on flat ground")
        told = [("walks on ground", *_planned(place / ground, files[ground]))]
        brace = _braced(found, place / chimney, robot_file, report)
    used = brace.posture
    if used is not None:
        files[chimney] = chimney_document(found, robot_file, used)
    told.append(("climbs between walls", *brace.outcome))
    notes = [f"implausible: {text}" for text in found.odd]
    notes += [f"assumed: {text}" for text in found.assumed]
    notes += [f"{what}: {'verified' if good else words}" for what, good, words in told]
    badges = [(what if good else f"not found: {what}", good) for what, good, _ in told]
    files[f"{name}.html"] = robot_page(found, used, badges)
    return NewRobot(name, files, tuple(notes))


@dataclass(frozen=True)
class _Brace:
    posture: Posture | None
    outcome: tuple[bool, str]


def _braced(found: Proposal, path: Path, robot_file: str, report: Callable[[str], None]) -> _Brace:
    """The first bracing posture that leads to a verified climb, else the best with its refusal."""
    if not found.braces:
        return _Brace(None, (False, "no posture between walls holds it with any leg lifted"))
    first: _Brace | None = None
    for number, brace in enumerate(_varied(found.braces)[:_TRIED], 1):
        report(f"planning a climb between walls, posture {number}")
        outcome = _planned(path, chimney_document(found, robot_file, brace))
        if outcome[0]:
            return _Brace(brace, outcome)
        first = first or _Brace(brace, outcome)
    return first or _Brace(None, (False, "no posture was tried"))


def _varied(braces: tuple[Posture, ...]) -> list[Posture]:
    """The best of each friction in turn, so that postures on rougher walls have their chance."""
    by_friction: dict[float, list[Posture]] = {}
    for brace in braces:
        by_friction.setdefault(brace.friction, []).append(brace)
    out: list[Posture] = []
    for own in by_friction.values():
        out += own[: _TRIED // len(by_friction)]
    return out


def _planned(path: Path, text: str) -> tuple[bool, str]:
    """Whether a spec leads to a verified plan by the global method, and else why not."""
    path.write_text(text, encoding="utf-8")
    try:
        plan(path, method="micp", time_limit=_LIMIT)
    except (NoPlanFound, PlanFails, SpecError, UsageError) as error:
        return False, str(error).partition("\n")[0]
    return True, ""


def _file_name(name: str) -> str:
    """A robot's name as one of a file."""
    return re.sub(r"[^a-z0-9]+", "_", name.lower()).strip("_") or "robot"


def package_urdf(package: str, robot: str | None = None) -> Path:
    """A URDF that an installed Python package ships: `example-robot-data` or `PACKAGE:ROBOT`.

    robot: part of the URDF's path, such as `anymal_c`. Raises UsageError, with what there is, where
    it is none or several.
    """
    package, _, part = package.partition(":")
    part = robot or part
    try:
        listed = distribution(package).files or []
    except (PackageNotFoundError, ValueError) as error:
        raise UsageError(f"no Python package {package!r} is installed") from error
    urdfs = [Path(str(f.locate())) for f in listed if f.name.endswith(".urdf")]
    urdfs = [path.resolve() for path in urdfs if path.is_file()]
    named = [path for path in urdfs if part.lower() in path.as_posix().lower()] if part else urdfs
    exact = [path for path in named if path.stem.lower() == part.lower()]
    if len(exact) == 1 or len(named) == 1:
        return (exact or named)[0]
    known = ", ".join(sorted(f"{path.parents[1].name}/{path.stem}" for path in named or urdfs))
    if not urdfs:
        raise UsageError(f"the package {package!r} ships no URDF")
    how = f"--package {package}:PART" if not named or not part else f"a longer part than {part!r}"
    raise UsageError(f"expected {how}, which names one URDF of: {known}")
