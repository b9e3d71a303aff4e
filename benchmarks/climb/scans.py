"""`scans`: meshes of another project, from the file to a verified plan that stands on it.

The meshes are those of the collection hpp-environments (BSD-2); a folder that holds them is given
with `--scenes`. Each has one spec, which states what a user would: the mesh, from where to where,
and how wide the hexapod stands. Regions, free space and rounds are found. The last, cubes that
stand apart one above the other, is climbed by a quadruped whose grippers open to them
(`specs/robot_long_climber.yaml`). Then the same programs are given to two ways of choosing
surfaces: branch and bound, and the L1 relaxation of SL1M.
"""

from __future__ import annotations

import tempfile
import time
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TextIO

from benchmarks.climb.shipped import Planned, planned_spec
from benchmarks.climb.stands import fares
from benchmarks.climb.triangle_walls import triangles
from climbplan.climb.check.verification import verify_plan
from climbplan.climb.motion.motion import StageClock, plan_motion
from climbplan.errors import NoPlanFound, SpecError, UsageError
from climbplan.schema.examples import read_example

_QUICK = ("stairs", "slope_towr")
_METHODS = ("micp", "sl1-relaxation")
_WALK = """\
kind: climb
robot: silvia
terrain:
  friction: 0.8
  scan: {{file: {file}, steepest_deg: 40{guide}}}
task:
  rounds: {rounds}
  start: {{com: {start}, rpy_deg: [0, 0, -90]}}
  goal: {{com: {goal}, rpy_deg: [{pitch}, 0, -90]}}
  stance: {{RF: [0.25, {side}, -{up}], RM: [{middle}, 0, -{up}], RR: [0.25, -{side}, -{up}],
    LR: [-0.25, -{side}, -{up}], LM: [-{middle}, 0, -{up}], LF: [-0.25, {side}, -{up}]}}
posture: {{steps: {{com_max: {step}}}}}
trajectory: {{swing_clearance: 0.06}}
margins: {{edge: {edge}}}
solver: {{method: {method}, time_limit: {limit}}}
"""

_GRIPS = """\
kind: climb
robot: robot_long_climber.yaml
terrain:
  friction: 0.8
  scan: {{file: {file}, holds: {{}}}}
task:
  rounds: auto
  start: {{com: [-0.2, -0.01, 0.9], rpy_deg: [90, 0, -130]}}
  goal: {{com: [-0.2, -0.09, 2.05], rpy_deg: [90, 0, -130], tolerance: 0.05}}
posture: {{steps: {{com_max: 0.2, toe_max: 0.6}}}}
solver: {{method: micp, window: 2, time_limit: 600}}
"""
_CLIMBED = "climb"  # the mesh of cubes


@dataclass(frozen=True)
class Walk:
    """A way over one mesh, for a hexapod that looks along x."""

    mesh: str
    start: str
    goal: str
    rounds: str = "auto"
    pitch: int = 0  # [deg] at the goal
    guide: str = ""  # points that the body passes
    method: str = "auto"
    side: float = 0.42  # [m] of the outer feet before and behind the body
    middle: float = 0.44  # [m] of the middle feet beside it
    up: float = 0.28  # [m] of the body over its feet
    step: float = 0.15  # [m] of the body in a round
    edge: float = 0.01  # [m] that toes keep off edges beyond which nothing goes on
    limit: int = 600  # [s]

    def spec(self, folder: Path) -> str:
        """The spec for the mesh of a folder."""
        own = vars(self) | {
            "file": (folder / f"{self.mesh}.stl").resolve(),
            "guide": f", guide: {self.guide}" if self.guide else "",
        }
        return _WALK.format(**own)


WALKS = {
    walk.mesh: walk
    for walk in (
        Walk("stairs", "[-0.45, 0.8, 0.28]", "[0.45, 0.8, 0.47]", "10", 18, method="micp"),
        Walk(
            "bauzil_stairs_clean",
            *("[-0.55, 1.0, 0.28]", "[0.35, 1.0, 0.46]"),
            rounds="10",
            pitch=18,
            method="micp",
        ),
        Walk("slope_towr", "[0.1, 0, 0.28]", "[0.95, 0, 0.36]", "9", 8, method="micp"),
        Walk(
            "rubbles_stairs_1",
            *("[0.2, 0, 0.28]", "[6.9, 0, 0.89]"),
            pitch=18,
            guide="[[4.5, 0, 0.28]]",
            edge=0.03,  # the stance is wider than its stairs, off whose sides toes came
        ),
        Walk(
            "slalom_debris",
            # Narrow: between the wall, which knees pass, and the far edge of the debris
            *("[-1.2, 0.1, 0.28]", "[1.6, 0.1, 0.28]"),
            guide="[[-1.0, 1.03, 0.3], [1.35, 1.03, 0.3]]",
            side=0.34,
            middle=0.36,
            step=0.12,
        ),
    )
}


def bench_scans(quick: bool, out: TextIO, folder: str | None) -> None:
    """One line a mesh, then surfaces chosen by two methods; two meshes and scenes with `quick`.

    Raises UsageError without a folder that holds the meshes, MissingSolver without MuJoCo.
    """
    names = _QUICK if quick else (*WALKS, _CLIMBED)
    where = Path(folder or ".")
    missing = [name for name in names if not (where / f"{name}.stl").is_file()]
    if missing:
        raise UsageError(
            f"no {missing[0]}.stl in {where}: give the folder with the meshes of "
            "hpp-environments by --scenes DIR"
        )
    head = f"{'mesh':<22}{'regions':>8}{'rounds':>8}{'windows':>9}{'verified':>10}{'stands':>22}"
    print(f"{head}{'CPU s':>8}{'s':>8}", file=out, flush=True)
    for name in names:
        begin = time.perf_counter()
        found = _planned(name, where, [])
        spent = time.perf_counter() - begin
        if isinstance(found, str):
            print(f"{name:<22}no plan: {found}", file=out, flush=True)
            continue
        plan = found.plan
        verified = "yes" if verify_plan(plan).passed else "no"
        windows = plan.sizes["posture"].get("windows", 1)
        line = f"{name:<22}{len(plan.terrain.regions):>8}{plan.rounds.count:>8}{windows:>9}"
        line += f"{verified:>10}{fares(plan, 'joints'):>22}"
        print(f"{line}{found.cpu:>8.1f}{spent:>8.1f}", file=out, flush=True)
    print(file=out, flush=True)
    _choices(names, where, quick, out)


def spec_of(name: str, where: Path) -> str:
    """The spec for a mesh of a folder."""
    if name == _CLIMBED:
        return _GRIPS.format(file=(where / f"{name}.stl").resolve())
    return WALKS[name].spec(where)


def _planned(name: str, where: Path, overrides: list[str]) -> Planned | str:
    """The plan of a mesh's spec, or in a line why there is none."""
    with tempfile.TemporaryDirectory() as spare:
        path = Path(spare, f"{name}.yaml")
        path.write_text(spec_of(name, where))
        robot = "robot_long_climber"
        path.with_name(f"{robot}.yaml").write_text(read_example(robot))
        try:
            return planned_spec(path, overrides)
        except (NoPlanFound, SpecError) as error:
            return str(error).partition("\n")[0]


def _choices(names: tuple[str, ...], where: Path, quick: bool, out: TextIO) -> None:
    """The same programs with surfaces by branch and bound and by the L1 relaxation of SL1M.

    Meshes whose rounds are stated, planned and verified; and two walls of 120 triangles each with
    a tenth to six tenths of them taken away, whose postures pass the exact kinematic checks.
    """
    head = f"{'surfaces by':<28}{'branch and bound':>18}{'CPU s':>8}"
    print(f"{head}{'sl1-relaxation':>16}{'CPU s':>8}{'cost':>8}", file=out, flush=True)
    for name in names:
        if name == _CLIMBED or WALKS[name].rounds == "auto":
            continue  # windows are drawn on by a cost, which the relaxation has not
        rows = []
        for method in _METHODS:
            spent = time.process_time()
            found = _planned(name, where, [f"solver.method={method}"])
            cost = None
            if not isinstance(found, str) and verify_plan(found.plan).passed:
                cost = float(found.plan.objective)
            rows.append((cost, time.process_time() - spent))
        _compared(name, rows, out)
    for gap in (0.1, 0.6) if quick else (0.1, 0.3, 0.45, 0.6):
        for seed in range(1 if quick else 3):
            rows = []
            for method in _METHODS:
                scene = triangles(120, gap, seed=seed)
                solver = scene.spec.solver.model_copy(update={"method": method})
                scene = replace(scene, spec=scene.spec.model_copy(update={"solver": solver}))
                spent = time.process_time()
                try:
                    clock = StageClock(lambda stage, fraction: None)
                    cost = float(plan_motion(scene, clock).posture.objective)
                except NoPlanFound:
                    cost = None
                rows.append((cost, time.process_time() - spent))
            _compared(f"triangles, {gap:.0%} gaps, seed {seed}", rows, out)


def _compared(name: str, rows: list[tuple[float | None, float]], out: TextIO) -> None:
    """Success and time of both methods, and what the relaxation's plan costs beside the other."""
    (best, first), (cost, second) = rows
    told = ["yes" if value is not None else "no" for value in (best, cost)]
    ratio = "-" if best is None or cost is None else f"{cost / best:.2f}"
    line = f"{name:<28}{told[0]:>18}{first:>8.1f}{told[1]:>16}{second:>8.1f}{ratio:>8}"
    print(line, file=out, flush=True)
