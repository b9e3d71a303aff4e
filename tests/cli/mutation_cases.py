"""Which mutants are made of which files, and which commands read them."""

from __future__ import annotations

import random
import shutil
import zlib
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from mutation_sources import CLOUDS, HEIGHT_MAPS, INSTANCES, MESHES, npy_of_shape, png_of_size
from mutations import mutated_text, mutated_urdf, mutated_yaml
from plan_mutations import mutate_plan

import climbplan

ROOT = Path(climbplan.__file__).parents[1]
SPECS = ROOT / "specs"
ROBOTS = ROOT / "climbplan" / "robots"
_OF_URDF = {
    "walker.urdf": ("robot_walker.yaml", "climb_walker.yaml"),
    "hexapod.urdf": ("robot_hexapod.yaml", "mpc_hexapod.yaml"),
    "biped.urdf": ("robot_biped.yaml", "climb_biped.yaml"),
    "telescope.urdf": ("robot_telescope.yaml", "climb_telescope.yaml", "mpc_telescope.yaml"),
}
_OUT = ["-o", "out", "-q", "--force"]

# Plans that are mutated: how each is made
PLANS = {
    "small_climb": ["plan-climb", str(ROOT / "tests" / "schema" / "small_climb.yaml")],
    "climb_tube": ["plan-climb", "climb_tube.yaml"],
    "limms_throw": ["plan-limms", "limms_throw.yaml"],
    "climb_walker": ["plan-climb", "climb_walker.yaml"],
    "climb_single_wall": ["plan-climb", "climb_single_wall.yaml"],
    "transition_flat": ["plan-transition", "transition_flat.yaml"],
    "mpc_forward": ["plan-mpc", "mpc_forward.yaml", "--method", "mpcc"],
    "mpc_disturbance": ["plan-mpc", "mpc_disturbance.yaml", "--method", "mpcc"],
    "bookshelf_scene": ["solve-bookshelf", "bookshelf_scene.yaml"],
    "dataset_bookshelf": ["gen-data", "dataset_bookshelf.yaml", "--set", "count=4"],
}
_FEW = 1000  # cases up to which plans of two kinds are enough
QUICK_PLANS = ("small_climb", "limms_throw")
# Specs of which a mutant that holds together is also planned, and within which bounds
_PLANNED = {
    "climb_tube.yaml": ["plan-climb", "--time-limit", "0.5"],
    "transition_flat.yaml": ["plan-transition", "--time-limit", "0.5"],
    "limms_throw.yaml": ["plan-limms", "--time-limit", "0.5"],
    "mpc_forward.yaml": ["plan-mpc", "--time-limit", "0.5", "--method", "mpcc"],
    "bookshelf_scene.yaml": ["solve-bookshelf", "--time-limit", "0.5"],
}


SHARES = {
    "spec": 17, "plan": 8, "urdf": 4, "robot": 5, "table": 3, "scenes": 2, "scan": 9, "gripper": 2,
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
        ("urdf", "telescope.urdf"),  # twice, as it is quick
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


def names_of_plans(count: int) -> tuple[str, ...]:
    """Return which plans so many cases mutate: two kinds of quick ones are enough for few."""
    return QUICK_PLANS if count <= _FEW else tuple(PLANS)


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
        return _of_plan(plans[case.source], folder / "plan.h5", rng)
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
        return changed, [["validate", rng.choice(_OF_URDF[case.source])]]
    if case.kind == "table":
        command = "fit-stiffness" if name == "limb_test.csv" else "!grips"
        return changed, [[command, name, *(_OUT if command[0] != "!" else [])]]
    return changed, _commands_of_spec(name, plans, rng)


def _of_plan(plan: Path, mutant: Path, rng: random.Random) -> tuple[str, list[list[str]]]:
    """A mutant of a plan, and one command: each of them verifies the plan before all else."""
    shutil.copy(plan, mutant)
    changed = mutate_plan(mutant, rng)
    name = mutant.name
    commands = [
        ["verify", name],
        ["verify", name],
        ["report", name, "--json"],
        ["export", name, "-o", "-", *rng.choice([["--unverified"], []])],
        ["view", name, "--no-browser"],
        ["export", name, "-o", "motion.npz", "--format", "npz", "--rate", "50", "--unverified"],
    ]
    if rng.random() < 0.03:
        commands = [["report", name, "-o", "page"]]
    return changed, [rng.choice(commands)]


def _commands_of_spec(name: str, plans: Mapping[str, Path], rng: random.Random) -> list[list[str]]:
    """What reads a spec or a robot file; some that are valid are also planned."""
    commands = [["validate", name]]
    if name in _PLANNED and rng.random() < 0.1:
        first, *options = _PLANNED[name]
        options += ["--no-report"] if first.startswith("plan-") else []
        commands.append([first, name, *_OUT, *options])
    if (stem := name.partition(".")[0]) in plans and stem != "dataset_bookshelf":
        commands.append(["verify", str(plans[stem]), "--spec", name])
    if rng.random() < 0.3:
        commands[-1].append("--json")
    return commands


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
