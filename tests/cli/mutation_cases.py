"""Which mutants are made of which files, and what comes of the commands that read them.

By hand: `python tests/cli/mutation_cases.py PLANS FOLDER SEED COUNT [WORD]` makes and runs mutants
(those whose name holds WORD), with the plans in PLANS, which are made there if they are missing.
"""

from __future__ import annotations

import json
import os
import random
import select
import shutil
import subprocess
import sys
import zlib
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import Any, Self

from mutations import mutated_text, mutated_urdf, mutated_yaml
from plan_mutations import mutate_plan

import climbplan

ROOT = Path(climbplan.__file__).parents[1]
SPECS = ROOT / "specs"
ROBOTS = ROOT / "climbplan" / "robots"
MOST_SECONDS = 10.0  # of CPU that a command may take for a mutant
_PATIENCE = 120.0  # [s] of waiting, on a machine that has other things to do
_OF_URDF = {
    "walker.urdf": ("robot_walker.yaml", "climb_walker.yaml"),
    "hexapod.urdf": ("robot_hexapod.yaml", "mpc_hexapod.yaml"),
    "biped.urdf": ("robot_biped.yaml", "climb_biped.yaml"),
    "telescope.urdf": ("robot_telescope.yaml", "climb_telescope.yaml", "mpc_telescope.yaml"),
}
_OUT = ["-o", "out", "-q", "--force"]

# Plans that are mutated: how each is made
PLANS = {
    "climb_tube": ["plan-climb", "climb_tube.yaml"],
    "limms_throw": ["plan-limms", "limms_throw.yaml"],
    "climb_walker": ["plan-climb", "climb_walker.yaml"],
    "climb_single_wall": ["plan-climb", "climb_single_wall.yaml"],
    "transition_flat": ["plan-transition", "transition_flat.yaml"],
    "mpc_forward": ["plan-mpc", "mpc_forward.yaml", "--method", "nlp"],
    "mpc_disturbance": ["plan-mpc", "mpc_disturbance.yaml", "--method", "nlp"],
    "bookshelf_scene": ["solve-bookshelf", "bookshelf_scene.yaml"],
    "dataset_bookshelf": ["gen-data", "dataset_bookshelf.yaml", "--set", "count=4"],
}
QUICK_PLANS = ("climb_tube", "limms_throw")
# Specs of which a mutant that holds together is also planned, and within which bounds
_PLANNED = {
    "climb_tube.yaml": ["plan-climb", "--time-limit", "2"],
    "transition_flat.yaml": ["plan-transition", "--time-limit", "2"],
    "limms_throw.yaml": ["plan-limms", "--time-limit", "2"],
    "mpc_forward.yaml": ["plan-mpc", "--time-limit", "2", "--method", "nlp"],
    "bookshelf_scene.yaml": ["solve-bookshelf", "--time-limit", "2"],
}


@dataclass(frozen=True)
class Case:
    """One mutant: what it is made of, and the number that decides how."""

    kind: str  # "spec", "robot", "urdf", "table", "scenes", "plan"
    source: str  # file name, of a plan its own
    number: int

    @property
    def name(self) -> str:
        """As in messages."""
        return f"{self.kind} {self.source} {self.number}"

    @property
    def rng(self) -> random.Random:
        """What decides."""
        return random.Random(zlib.crc32(self.name.encode()))


@dataclass(frozen=True)
class Outcome:
    """How one command ended with a mutant."""

    case: Case
    changed: str
    command: str
    code: int  # -1: an exception came through; -2: it ended by a signal; -3: did not end
    seconds: float
    said: str

    @property
    def is_bug(self) -> bool:
        """Whether it ended as nothing may end."""
        return self.code in (-1, -2, -3, 1) or self.seconds > MOST_SECONDS

    def __str__(self) -> str:
        tail = self.said.strip().splitlines()[-2:]
        how = f"exit {self.code}, {self.seconds:.1f} s"
        return f"{self.case.name} ({self.changed}): {self.command}: {how}: {' '.join(tail)}"


def every_source(plans: Mapping[str, Path]) -> list[tuple[str, str]]:
    """Kind and name of every file that is mutated, with these plans."""
    specs = sorted(path.name for path in SPECS.glob("*.yaml"))
    found = [("spec", name) for name in specs if not name.startswith("robot_")]
    robots = ("silvia.yaml", "scaler.yaml", "modules/limms.yaml", "bodies/scaler.yaml")
    ours = (
        "robot_walker.yaml", "robot_hexapod.yaml", "robot_telescope.yaml", "robot_biped.yaml",
    )  # fmt: skip
    found += [("robot", name) for name in (*robots, *ours)]
    found += [
        ("urdf", "walker.urdf"),
        ("urdf", "hexapod.urdf"),
        ("urdf", "telescope.urdf"),
        ("urdf", "biped.urdf"),
        ("table", "limb_test.csv"),
        ("scenes", "bookshelf_scenes.h5"),
    ]
    return found + [("plan", name) for name in plans]


def cases(seed: int, count: int, plans: Mapping[str, Path]) -> list[Case]:
    """So many mutants: a half of plans, a sixth of URDFs and robots, the rest of specs."""
    rng = random.Random(seed)
    sources: dict[str, list[str]] = {}
    for kind, name in every_source(plans):
        sources.setdefault(kind, []).append(name)
    shares = {"spec": 8, "plan": 12, "urdf": 3, "robot": 2, "table": 1, "scenes": 1}
    kinds = [kind for kind, share in shares.items() if kind in sources for _ in range(share)]
    chosen = [rng.choice(kinds) for _ in range(count)]
    return [Case(kind, rng.choice(sources[kind]), rng.randrange(10**6)) for kind in chosen]


def prepared(case: Case, folder: Path, plans: Mapping[str, Path]) -> tuple[str, list[list[str]]]:
    """Make a mutant in an empty folder; what was done, and the commands to run there."""
    rng = case.rng
    if case.kind == "plan":
        path = folder / "plan.h5"
        shutil.copy(plans[case.source], path)
        changed = mutate_plan(path, rng)
        commands = [
            ["verify", "plan.h5"],
            ["report", "plan.h5", "--json"],
            ["export", "plan.h5", "-o", "-"],
            ["view", "plan.h5", "--no-browser"],
        ]
        if rng.random() < 0.3:
            commands.append(["report", "plan.h5", "-o", "page"])
        return changed, commands
    for path in SPECS.iterdir():
        (folder / path.name).symlink_to(path)
    name = Path(case.source).name
    home = ROBOTS if case.kind == "robot" and not (SPECS / case.source).exists() else SPECS
    content = (home / case.source).read_bytes()
    (folder / name).unlink(missing_ok=True)
    if case.kind == "scenes":
        (folder / name).write_bytes(content)
        return mutate_plan(folder / name, rng), [["validate", "bookshelf_file.yaml"]]
    mutate = {"urdf": mutated_urdf, "table": mutated_text}.get(case.kind, mutated_yaml)
    changed, content = mutate(content, rng)
    (folder / name).write_bytes(content)
    if case.kind == "urdf":
        return changed, [["validate", *_OF_URDF[case.source]]]
    if case.kind == "table":
        return changed, [["fit-stiffness", name, *_OUT]]
    commands = [["validate", name]]
    if name in _PLANNED and rng.random() < 0.5:
        first, *options = _PLANNED[name]
        options += ["--no-report"] if first.startswith("plan-") else []
        commands.append([first, name, *_OUT, *options])
    if (stem := name.partition(".")[0]) in plans and stem != "dataset_bookshelf":
        commands.append(["verify", str(plans[stem]), "--spec", name])
    if rng.random() < 0.3:
        commands[-1].append("--json")
    return changed, commands


class Worker:
    """Context: runs mutants in a process of its own, a new one where one does not come back."""

    def __init__(self, folder: Path, plans: Mapping[str, Path]) -> None:
        self.folder = folder
        self.plans = plans
        self._process: subprocess.Popen[str] | None = None
        self._count = 0

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._end()

    def outcomes(self, case: Case) -> list[Outcome]:
        """What comes of one mutant; its folder stays where something is wrong."""
        self._count += 1
        folder = self.folder / f"{self._count:04d}"
        folder.mkdir(parents=True)
        changed, commands = prepared(case, folder, self.plans)
        found = [
            Outcome(case, changed, f"cd {folder} && climbplan {' '.join(command)}", *answer)
            for command, answer in zip(commands, self._answers(folder, commands), strict=False)
        ]
        if not any(outcome.is_bug for outcome in found):
            shutil.rmtree(folder)
        return found

    def _answers(self, folder: Path, commands: list[list[str]]) -> Iterator[tuple[int, float, str]]:
        for command in commands:
            process = self._running()
            assert process.stdin is not None
            assert process.stdout is not None
            asked = {"folder": str(folder), "commands": [command]}
            process.stdin.write(json.dumps(asked) + "\n")
            process.stdin.flush()
            ready, _, _ = select.select([process.stdout], [], [], _PATIENCE)
            if not ready:
                self._end()
                yield -3, _PATIENCE, "did not end"
                continue
            line = process.stdout.readline()
            if not line:
                code = process.wait()
                self._process = None
                yield -2, 0.0, f"the process ended with {code}"
                continue
            answer: dict[str, Any] = json.loads(line)[0]
            yield answer["code"], answer["seconds"], answer["said"]

    def _running(self) -> subprocess.Popen[str]:
        if self._process is None:
            here = Path(__file__).parent
            self._process = subprocess.Popen(
                [sys.executable, str(here / "mutation_worker.py")],
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                text=True,
                env={**os.environ, "PYTHONPATH": f"{ROOT}{os.pathsep}{here}", "NO_COLOR": "1"},
            )
            # What is loaded and compiled at the first use is no mutant's fault
            for _ in self._answers(SPECS, [["validate", "climb_tube.yaml", "mpc_forward.yaml"]]):
                pass
        return self._process

    def _end(self) -> None:
        if self._process is not None:
            self._process.kill()
            self._process.communicate()
            self._process = None


def made_plans(folder: Path, names: tuple[str, ...] | None = None) -> dict[str, Path]:
    """A plan of each kind below a folder, by name; those that are there are kept."""
    found = {}
    for name in names or tuple(PLANS):
        path = folder / name / ("dataset.h5" if name.startswith("dataset") else "plan.h5")
        if not path.exists():
            command = [*PLANS[name], "-o", str(folder / name), "-q", "--force"]
            command += ["--no-report"] if command[0].startswith("plan-") else []
            subprocess.run(
                [sys.executable, "-m", "climbplan", *command],
                cwd=SPECS,
                check=False,  # 5 where a plan is not verified: it is a plan all the same
                stdout=subprocess.DEVNULL,
                env={**os.environ, "PYTHONPATH": str(ROOT)},
            )
        assert path.exists(), name
        found[name] = path
    return found


def main() -> None:
    """Make and run mutants by hand."""
    plans = made_plans(Path(sys.argv[1]).resolve())
    folder, seed, count = Path(sys.argv[2]).resolve(), int(sys.argv[3]), int(sys.argv[4])
    word = sys.argv[5] if len(sys.argv) > 5 else ""
    codes: dict[int, int] = {}
    with Worker(folder, plans) as worker:
        for case in cases(seed, count, plans):
            if word not in case.name:
                continue
            for outcome in worker.outcomes(case):
                codes[outcome.code] = codes.get(outcome.code, 0) + 1
                if outcome.is_bug:
                    print(outcome, flush=True)
    print(codes)


if __name__ == "__main__":
    main()
