"""`courses`: stairs, rubble and stepping stones of seeded meshes, for two quadrupeds and a hexapod.

A spec states what a user would: the mesh, the way, how the robot stands and how far it steps. The
quadrupeds are those that `new robot` proposes from their URDFs. Planned is what is verified; it
stands if it does not fall in MuJoCo.
"""

from __future__ import annotations

import statistics
import tempfile
import time
from contextlib import ExitStack
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, TextIO

import numpy as np

from benchmarks.climb.course_meshes import COURSES, write_course
from benchmarks.climb.stands import fares
from benchmarks.kept_rows import read_rows, write_rows
from benchmarks.zoo.robot_files import keep_robot
from benchmarks.zoo.robots import ROBOTS
from climbplan.climb.check.verification import verify_plan
from climbplan.climb.planner.planner import plan_climb
from climbplan.climb.schema.loading import load_climb
from climbplan.errors import NoPlanFound, SpecError, UsageError
from climbplan.robots.any_robot import build_robot
from climbplan.robots.urdf.proposal.propose_robot import propose_robot
from climbplan.schema.robots.source import load_any_robot

_QUADRUPEDS = ("A1", "ANYmal C")
_HEXAPOD = "silvia"
_HEXAPOD_STANCE = (
    "{RF: [0.256, 0.445, -0.24], RM: [0.514, 0, -0.24], RR: [0.256, -0.445, -0.24], "
    "LR: [-0.256, -0.445, -0.24], LM: [-0.514, 0, -0.24], LF: [-0.256, 0.445, -0.24]}"
)
_STEP_FRACTION = 0.4  # of the body's height: its longest step
_SHIFT_FRACTION = 0.6  # of the toes' level distance from the body
_COUNTS = {"stairs": 20, "rubble": 20, "stones": 10}
_LIMIT = 120  # [s]
_SPEC = """\
kind: climb
robot: {robot}
terrain: {{friction: 0.8, scan: {{file: {mesh}}}}}
task:
  rounds: auto
  start: {{com: [0, {start:.3f}, {height:.4f}]}}
  goal: {{com: [0, {length:.3f}, {end:.4f}], tolerance: 0.05}}
  {stance}
posture:
  rotation_limit_deg: 25
  steps: {{com_max: {step:.3f}, toe_max: {toe_step:.3f}, com_shift_max: {shift:.3f}}}
force: {{safety_friction: 1.2}}
trajectory: {{speed: 0.02}}
solver: {{time_limit: {limit}}}
"""


@dataclass(frozen=True)
class CourseRow:
    """One course for one robot."""

    robot: str
    course: str
    seed: int
    outcome: str  # how the plan ends in MuJoCo; else why there is none
    is_verified: bool
    rounds: int
    cpu: float  # [s] of planning and verification


@dataclass(frozen=True)
class Walker:
    """A robot as specs state it."""

    name: str
    file: str
    height: float  # [m] of the body over its footholds
    shift: float  # [m] of the body over the standing limbs
    stance: str  # key of the task
    start: float = 0.0  # [m] along y


def bench_courses(
    seed: int,
    quick: bool,
    out: TextIO,
    count: int | None = None,
    scenes: str | None = None,
    folder: Path | None = None,
) -> dict[str, Any]:
    """Print a line a robot and kind of course; one course each with `quick`. Return all rows.

    Args:
        seed: Of the first mesh of each kind; the next ones follow.
        quick: Whether to take one mesh of each kind.
        out: Takes the table, each line as soon as it is known.
        count: Of meshes of each kind; None takes all.
        scenes: Kinds by commas; None takes all.
        folder: Keeps a row a course, which later runs do not measure again.

    Raises:
        UsageError: Of `scenes` a kind is not known, the robots' package is missing, or the folder
            holds something else.
    """
    kinds = [kind.strip() for kind in (scenes or ",".join(COURSES)).split(",")]
    if unknown := [kind for kind in kinds if kind not in COURSES]:
        raise UsageError(
            f"`courses` --scenes: no course {unknown[0]!r}, known are {', '.join(COURSES)}"
        )
    head = f"{'robot':<10}{'course':<8}{'verified':>10}{'stand':>10}{'no slip':>10}"
    print(f"{head}{'median CPU s':>14}{'max':>7}", file=out, flush=True)
    file = None if folder is None else folder / "courses.csv"
    known = [] if file is None else read_rows(file, CourseRow)
    measured = {(row.robot, row.course, row.seed): row for row in known}
    rows: list[CourseRow] = []
    with tempfile.TemporaryDirectory() as name:
        for walker in propose_walkers(Path(name)):
            for kind in kinds:
                number = 1 if quick else min(count or _COUNTS[kind], _COUNTS[kind])
                for each in range(seed, seed + number):
                    cell = walker.name, kind, each
                    if cell not in measured:
                        measured[cell] = _plan_course(walker, kind, each, Path(name))
                        if file is not None:
                            write_rows(file, list(measured.values()))
                    rows.append(measured[cell])
                _print_summary(walker.name, kind, rows[-number:], out)
    for row in rows:
        if not row.is_verified:
            print(f"  {row.robot}, {row.course} {row.seed}: {row.outcome}", file=out)
    return {"rows": [asdict(row) for row in rows]}


def _print_summary(robot: str, kind: str, rows: list[CourseRow], out: TextIO) -> None:
    verified = [row for row in rows if row.is_verified]
    num_standing = sum(not row.outcome.startswith("falls") for row in verified)
    num_without_slip = sum(row.outcome == "stands" for row in verified)
    cpu = [row.cpu for row in rows]
    line = f"{robot:<10}{kind:<8}{f'{len(verified)} of {len(rows)}':>10}"
    line += "".join(f"{f'{n} of {len(verified)}':>10}" for n in (num_standing, num_without_slip))
    print(f"{line}{statistics.median(cpu):>14.1f}{max(cpu):>7.1f}", file=out, flush=True)


def propose_walkers(folder: Path) -> list[Walker]:
    """Return the quadrupeds as proposed from their URDFs, and the hexapod.

    Args:
        folder: Where the quadrupeds' robot files are written.
    """
    walkers = []
    for public in (robot for robot in ROBOTS if robot.name in _QUADRUPEDS):
        with ExitStack() as stack:
            path = keep_robot(folder, public, propose_robot(public.urdf(stack)))
            robot = build_robot(load_any_robot(path))
        toes = robot.stance_body
        height = -float(toes[:, 2].mean()) + (0.0 if robot.foot is None else robot.foot.radius)
        shift = _SHIFT_FRACTION * float(np.linalg.norm(toes[:, :2], axis=1).max())
        rear, front = (order(toes[:, 1]) for order in (min, max))
        names = sorted(
            range(len(toes)), key=lambda i: (toes[i, 0] > 0, toes[i, 1] > (rear + front) / 2)
        )
        gait = f"gait: [{', '.join(robot.limb_names[i] for i in names)}]"
        walkers.append(Walker(public.name, path.name, height, shift, gait))
    return [*walkers, Walker(_HEXAPOD, _HEXAPOD, 0.24, 0.1, f"stance: {_HEXAPOD_STANCE}", -0.25)]


def _plan_course(walker: Walker, kind: str, seed: int, folder: Path) -> CourseRow:
    spec = write_spec(walker, kind, seed, folder)
    begin = time.process_time()
    try:
        plan = plan_climb(load_climb(spec))
        objection = verify_plan(plan).objection
    except (NoPlanFound, SpecError) as error:
        spent = time.process_time() - begin
        outcome = " ".join(str(error).replace(str(folder), "").splitlines()[:2])
        return CourseRow(walker.name, kind, seed, outcome, False, 0, round(spent, 2))
    spent = time.process_time() - begin
    outcome = objection or fares(plan, "joints")
    return CourseRow(
        walker.name, kind, seed, outcome, not objection, plan.rounds.count, round(spent, 2)
    )


def write_spec(walker: Walker, kind: str, seed: int, folder: Path) -> Path:
    """Write mesh and spec of a course for a robot into a folder; return the spec's path."""
    mesh, course = write_course(kind, seed, folder)
    step = _STEP_FRACTION * walker.height
    text = _SPEC.format(
        robot=walker.file,
        mesh=mesh.name,
        start=walker.start,
        height=walker.height,
        length=course.length,
        end=course.rise + walker.height,
        stance=walker.stance,
        step=step,
        toe_step=4 * step,
        shift=walker.shift,
        limit=_LIMIT,
    )
    path = folder / f"{walker.name.replace(' ', '_')}_{kind}{seed}.yaml"
    path.write_text(text, encoding="utf-8")
    return path
