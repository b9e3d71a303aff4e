"""Which mutants are made of which files, and what comes of the commands that read them.

By hand: `python tests/cli/mutation_cases.py PLANS FOLDER SEED COUNT [WORD]` makes and runs mutants
(those whose name holds WORD), with the plans in PLANS, which are made there if they are missing.
PYTHONPATH: the checkout, tests/cli and tests/learning.
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

from mutation_sources import (
    CLOUDS,
    HEIGHT_MAPS,
    INSTANCES,
    MESHES,
    made_sources,
    npy_of_shape,
    png_of_size,
)
from mutations import mutated_text, mutated_urdf, mutated_yaml
from plan_mutations import mutate_plan

import climbplan

ROOT = Path(climbplan.__file__).parents[1]
SPECS = ROOT / "specs"
ROBOTS = ROOT / "climbplan" / "robots"
MOST_SECONDS = 10.0  # of CPU that a command may take for a mutant
MOST_MEMORY = 2 * 2**30  # [bytes]
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
FEW = 1000  # cases up to which plans of two kinds are enough
QUICK_PLANS = ("climb_tube", "limms_throw")
# Specs of which a mutant that holds together is also planned, and within which bounds
_PLANNED = {
    "climb_tube.yaml": ["plan-climb", "--time-limit", "2"],
    "transition_flat.yaml": ["plan-transition", "--time-limit", "2"],
    "limms_throw.yaml": ["plan-limms", "--time-limit", "2"],
    "mpc_forward.yaml": ["plan-mpc", "--time-limit", "2", "--method", "nlp"],
    "bookshelf_scene.yaml": ["solve-bookshelf", "--time-limit", "2"],
}


_Answer = tuple[int, float, str, int]  # code, seconds, what was said, memory
SHARES = {
    "spec": 17, "plan": 8, "urdf": 6, "robot": 5, "table": 3, "scenes": 2, "scan": 9, "gripper": 2,
    "model": 3, "certificate": 2, "instance": 3, "environment": 1,
}  # fmt: skip
_LONG = "x" * 300
# Environment variables that libraries or we read, and values that none of them expects
VARIABLES = {
    **{name: ["0", "-1", "abc", "", "1e3", "99999999999999999999", _LONG] for name in (
        "NUMBA_NUM_THREADS", "SOURCE_DATE_EPOCH", "OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS",
        "COLUMNS", "LINES", "NUMBA_OPT", "PYTHONOPTIMIZE",
    )},
    **{name: ["", "nonsense", "/nowhere", _LONG, "\u00e9"] for name in (
        "HOME", "TMPDIR", "NUMBA_CACHE_DIR", "MPLCONFIGDIR", "XDG_CACHE_HOME", "TERM", "LANG",
        "LC_ALL", "TZ", "MUJOCO_GL", "ROS_PACKAGE_PATH", "HDF5_USE_FILE_LOCKING", "BROWSER",
        "NO_COLOR",
    )},
    "MPLBACKEND": ["module://matplotlib_inline.backend_inline", "nonsense", "TkAgg", ""],
    "PYTHONIOENCODING": ["ascii", "latin-1", "utf-16", "cp437", "ascii:strict"],
}  # fmt: skip
_FIRST_COMMANDS = (
    ["validate", str(SPECS / "climb_tube.yaml"), "--json"],
    ["validate", f"{_LONG}.yaml"],
    ["robot", "silvia"],
    ["schema", "climb"],
    ["new", "climb", "here"],
    ["new", "climb", _LONG],
    ["verify", _LONG],
    ["data", "info", _LONG],
    ["--help"],
)


@dataclass(frozen=True)
class Case:
    """One mutant: what it is made of, and the number that decides how."""

    kind: str  # a key of `SHARES`
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
    memory: int = 0  # [bytes] largest so far of the process

    @property
    def is_bug(self) -> bool:
        """Whether it ended as nothing may end."""
        bad_end = self.code in (-1, -2, -3, 1) or "Traceback" in self.said
        return bad_end or self.seconds > MOST_SECONDS or self.memory > MOST_MEMORY

    def __str__(self) -> str:
        tail = self.said.strip().splitlines()[-2:]
        how = f"exit {self.code}, {self.seconds:.1f} s, {self.memory / 2**20:.0f} MiB"
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
        ("table", "grips.csv"),
        ("scenes", "bookshelf_scenes.h5"),
        ("gripper", "gripper.json"),
        ("model", "model.h5"),
        ("model", "envelopes.h5"),
        ("certificate", "proof.h5"),
        ("environment", "variables"),
    ]
    found += [("scan", name) for name in (*MESHES, *CLOUDS, *HEIGHT_MAPS)]
    found += [("instance", name) for name in INSTANCES]
    return found + [("plan", name) for name in plans]


def cases(seed: int, count: int, plans: Mapping[str, Path]) -> list[Case]:
    """So many mutants, of kinds by their shares."""
    rng = random.Random(seed)
    sources: dict[str, list[str]] = {}
    for kind, name in every_source(plans):
        sources.setdefault(kind, []).append(name)
    kinds = [kind for kind, share in SHARES.items() if kind in sources for _ in range(share)]
    chosen = [rng.choice(kinds) for _ in range(count)]
    return [Case(kind, rng.choice(sources[kind]), rng.randrange(10**6)) for kind in chosen]


def prepared(
    case: Case, folder: Path, plans: Mapping[str, Path], sources: Path
) -> tuple[str, list[list[str]]]:
    """Make a mutant in an empty folder; what was done, and the commands to run there.

    sources: folder of `made_sources`. A command whose first word begins with ! is no command line:
    `mutation_worker.py` says what it is.
    """
    rng = case.rng
    if case.kind == "environment":
        name = rng.choice(sorted(VARIABLES))
        value = rng.choice(VARIABLES[name])
        return f"{name}={value!r}", [["!environment", name, value, *rng.choice(_FIRST_COMMANDS)]]
    if case.kind in ("scan", "gripper", "model", "certificate", "instance"):
        return _of_source(case, folder, sources)
    if case.kind == "plan":
        path = folder / "plan.h5"
        shutil.copy(plans[case.source], path)
        changed = mutate_plan(path, rng)
        others = [
            ["report", "plan.h5", "--json"],
            ["export", "plan.h5", "-o", "-"],
            ["view", "plan.h5", "--no-browser"],
            ["export", "plan.h5", "-o", "motion.npz", "--format", "npz", "--rate", "50"],
        ]
        if rng.random() < 0.05:
            others = [["report", "plan.h5", "-o", "page"]]
        return changed, [["verify", "plan.h5"], rng.choice(others)]
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
        command = "fit-stiffness" if name == "limb_test.csv" else "!grips"
        return changed, [[command, name, *(_OUT if command[0] != "!" else [])]]
    commands = [["validate", name]]
    if name in _PLANNED and rng.random() < 0.1:
        first, *options = _PLANNED[name]
        options += ["--no-report"] if first.startswith("plan-") else []
        commands.append([first, name, *_OUT, *options])
    if (stem := name.partition(".")[0]) in plans and stem != "dataset_bookshelf":
        commands.append(["verify", str(plans[stem]), "--spec", name])
    if rng.random() < 0.3:
        commands[-1].append("--json")
    return changed, commands


def _of_source(case: Case, folder: Path, sources: Path) -> tuple[str, list[list[str]]]:
    """A mutant of one of `made_sources`."""
    rng, name = case.rng, case.source
    for path in sources.glob(f"{name.partition('.')[0]}.*"):
        shutil.copy(path, folder)
    path = folder / name
    if name.endswith(".h5"):
        changed = mutate_plan(path, rng)
    elif name.endswith((".npy", ".png")) and rng.random() < 0.3:
        changed, content = _claimed(name, rng)
        path.write_bytes(content)
    else:
        other = folder / f"{name.partition('.')[0]}.sol"
        path = other if case.kind == "instance" and rng.random() < 0.2 else path
        changed, content = mutated_text(path.read_bytes(), rng)
        path.write_bytes(content)
    if case.kind == "scan":
        settings = ["-s", "cell=0.1"] if name in HEIGHT_MAPS and name != "map.tif" else []
        return changed, [["fit-terrain", name, *_OUT, "--no-report", *settings]]
    commands = {
        "gripper": [["!gripper", name]],
        "instance": [["!instance", name, f"{name.partition('.')[0]}.sol"]],
        "certificate": [["verify", name]],
        "model.h5": [["!model", name], ["verify", name]],
        "envelopes.h5": [["!envelopes", name], ["verify", name]],
    }
    return changed, commands.get(case.kind) or commands[name]


def _claimed(name: str, rng: random.Random) -> tuple[str, bytes]:
    """A file of a size that it only claims, or of little that expands to it."""
    numbers = [0, -1, 1, 3, 4, 100, 5000, 10**6, 2**31, 2**32, 2**62, 2**64, 10**30]
    if name.endswith(".npy"):
        shape = tuple(rng.choice(numbers) for _ in range(rng.choice([1, 2, 2, 3, 40])))
        return f"claims {shape}"[:60], npy_of_shape(shape, rng.choice(["<f8", "|O", "|S0", "|u1"]))
    width, height = (rng.choice([1, 3, 100, 5000, 4999, 30000, 2**31 - 1]) for _ in range(2))
    real = min((width + 1) * height, 26_000_000) if rng.random() < 0.7 else 1000
    return f"{width} x {height} in {real}", png_of_size(width, height, bytes(real))


class Worker:
    """Context: runs mutants in a process of its own, a new one where one does not come back."""

    def __init__(self, folder: Path, plans: Mapping[str, Path]) -> None:
        self.folder = folder
        self.plans = plans
        self.sources = folder.parent / "sources"
        made_sources(self.sources)
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
        changed, commands = prepared(case, folder, self.plans, self.sources)
        found = [
            Outcome(case, changed, f"cd {folder} && climbplan {' '.join(command)}", *answer)
            for command, answer in zip(commands, self._answers(folder, commands), strict=False)
        ]
        if not any(outcome.is_bug for outcome in found):
            shutil.rmtree(folder)
        return found

    def _answers(
        self, folder: Path, commands: list[list[str]]
    ) -> Iterator[tuple[int, float, str, int]]:
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
                yield -3, _PATIENCE, "did not end", 0
                continue
            line = process.stdout.readline()
            if not line:
                code = process.wait()
                self._process = None
                yield -2, 0.0, f"the process ended with {code}", 0
                continue
            answer: dict[str, Any] = json.loads(line)[0]
            yield answer["code"], answer["seconds"], answer["said"], answer["memory"]
            if answer["memory"] > MOST_MEMORY:
                self._end()  # the next one is measured anew

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
            first = [
                ["validate", "climb_tube.yaml", "mpc_forward.yaml"],
                ["fit-terrain", str(self.sources / "mesh.stl"), "-o", str(self.sources / "fit")],
            ]
            for _ in self._answers(SPECS, first):
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
    folder, seed, count = Path(sys.argv[2]).resolve(), int(sys.argv[3]), int(sys.argv[4])
    plans = made_plans(Path(sys.argv[1]).resolve(), QUICK_PLANS if count <= FEW else None)
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
