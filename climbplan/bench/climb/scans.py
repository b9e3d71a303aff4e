"""`bench scans`: meshes of another project, from the file to a verified plan that stands on it.

The meshes are those of the collection hpp-environments (BSD-2); a folder that holds them is given
with `--scenes`. Each has one spec, which states what a user would: the mesh, from where to where,
and how wide the hexapod stands. Regions, free space and rounds are found.
"""

from __future__ import annotations

import tempfile
import time
from dataclasses import dataclass
from pathlib import Path
from typing import TextIO

from climbplan.bench.climb.shipped import planned_spec
from climbplan.bench.climb.stands import fares
from climbplan.climb.check.verification import verification_of
from climbplan.errors import NoPlanFound, SpecError, UsageError

_QUICK = ("stairs", "slope_towr")
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
trajectory: {{lift: 0.06}}
solver: {{method: {method}, time_limit: {limit}}}
"""


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
    """One line a mesh; two meshes with `quick`.

    Raises UsageError without a folder that holds the meshes, MissingSolver without MuJoCo.
    """
    names = _QUICK if quick else tuple(WALKS)
    where = Path(folder or ".")
    missing = [name for name in names if not (where / f"{name}.stl").is_file()]
    if missing:
        raise UsageError(
            f"no {missing[0]}.stl in {where}: give the folder with the meshes of "
            "hpp-environments by --scenes DIR"
        )
    head = f"{'mesh':<22}{'regions':>8}{'rounds':>8}{'windows':>9}{'verified':>10}{'stands':>22}"
    print(f"{head}{'CPU s':>8}{'s':>8}", file=out)
    for name in names:
        with tempfile.TemporaryDirectory() as spare:
            path = Path(spare, f"{name}.yaml")
            path.write_text(WALKS[name].spec(where))
            begin = time.perf_counter()
            try:
                found = planned_spec(path, [])
            except (NoPlanFound, SpecError) as error:
                why = str(error).partition("\n")[0]
                print(f"{name:<22}no plan: {why}", file=out, flush=True)
                continue
            spent = time.perf_counter() - begin
        plan = found.plan
        verified = "yes" if verification_of(plan).passed else "no"
        windows = plan.sizes["posture"].get("windows", 1)
        line = f"{name:<22}{len(plan.terrain.regions):>8}{plan.rounds.count:>8}{windows:>9}"
        line += f"{verified:>10}{fares(plan, 'joints'):>22}"
        print(f"{line}{found.cpu:>8.1f}{spent:>8.1f}", file=out, flush=True)
