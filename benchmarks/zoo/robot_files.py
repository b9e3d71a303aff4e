"""Robot files of the zoo: what is proposed of a robot, once for its plans and its refusals."""

from __future__ import annotations

from contextlib import ExitStack
from pathlib import Path

from benchmarks.zoo.robots import Zoo
from climbplan.climb.proposed.proposed import format_file_name
from climbplan.errors import UsageError
from climbplan.robots.urdf.proposal.prepared_robot import RobotProposal
from climbplan.robots.urdf.proposal.propose_robot import propose_robot
from climbplan.robots.urdf.proposal.robot_document import format_robot_document


def keep_robot(files: Path, zoo: Zoo, found: RobotProposal) -> Path:
    """Write a robot file in `files`; raises UsageError where that cannot be."""
    path = _path(files, zoo)
    try:
        files.mkdir(parents=True, exist_ok=True)
        path.write_text(format_robot_document(found, str(found.draft.urdf), ""), encoding="utf-8")
    except OSError as error:
        raise UsageError(f"{path}: cannot be written: {error.strerror}") from error
    return path


def robot_file(files: Path, zoo: Zoo) -> Path:
    """The file of a robot; it is proposed anew where there is none, as of rows kept without."""
    path = _path(files, zoo)
    if path.exists():
        return path
    with ExitStack() as stack:
        return keep_robot(files, zoo, propose_robot(zoo.urdf(stack)))


def _path(files: Path, zoo: Zoo) -> Path:
    return files / f"{format_file_name(zoo.name)}.yaml"
