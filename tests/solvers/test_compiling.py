"""Where compiled functions are kept, and the line that tells of compilation."""

from __future__ import annotations

import ctypes
import logging
import os
import re
import shutil
import stat
import subprocess
import sys
from pathlib import Path

import numba
import pytest

import climbplan
from climbplan import compiling, precompiled, wheel_hook
from climbplan.cli.console import Invocation, plain_messages
from climbplan.solvers.mixed_integer.compiling import SOURCES
from climbplan.wheel_hook import PrecompilingHook

PACKAGE = Path(climbplan.__file__).parent
ROOM = """
import sys
from pathlib import Path
import numpy as np
from climbplan.compiling import create_compiler

compiled = create_compiler(Path(__file__).parent, "compiled_*.py")
STEPS = np.array([1.0, 2.0])

@compiled
def _stepped(x: float, i: int) -> float:
    if i >= len(STEPS):
        raise ValueError("no such step")
    return x + STEPS[i]

@compiled
def _twice(x: float, i: int) -> float:
    return _stepped(_stepped(x, i), i)

@compiled
def one(x: float, i: int) -> float:
    return _stepped(x, i)

@compiled
def other(x: float, i: int) -> float:
    return _twice(x, i)

if "other" not in sys.argv:
    assert one(1.0, 0) == 2.0
    print(sum(one.stats.cache_hits.values()))
else:
    assert other(1.0, 1) == 5.0
    try:
        other(1.0, 2)
    except ValueError as error:
        print(error)
    print(*[sum(f.stats.cache_hits.values()) for f in (other, _twice, _stepped)])
"""
_PRIVILEGES = (1, 2, 3)  # CAP_DAC_OVERRIDE, CAP_DAC_READ_SEARCH, CAP_FOWNER
_DROP = 24  # prctl's PR_CAPBSET_DROP


def like_any_user() -> None:
    """Have even root heed permissions from the next program on."""
    for privilege in _PRIVILEGES:
        ctypes.CDLL(None).prctl(_DROP, privilege, 0, 0, 0)


def run(folder: Path, *command: str, **environment: str) -> subprocess.CompletedProcess[str]:
    plain = {k: v for k, v in os.environ.items() if k not in ("NUMBA_CACHE_DIR", "XDG_CACHE_HOME")}
    return subprocess.run(
        [sys.executable, "-W", "error::UserWarning", *command],
        cwd=folder,
        env={**plain, "PYTHONPATH": str(PACKAGE.parent), **environment},
        capture_output=True,
        text=True,
        check=True,
        preexec_fn=like_any_user,
    )


def forbid_writing(folder: Path) -> None:
    for path in [folder, *folder.rglob("*")]:
        path.chmod(path.stat().st_mode & ~(stat.S_IWUSR | stat.S_IWGRP | stat.S_IWOTH))


def allow_writing(folder: Path) -> None:
    for path in [folder, *folder.rglob("*")]:
        path.chmod(path.stat().st_mode | stat.S_IWUSR)


@pytest.fixture
def room(tmp_path: Path) -> Path:
    place = tmp_path / "room"
    place.mkdir()
    (place / "compiled_one.py").write_text(ROOM)
    return place


def kept_in(folder: Path) -> bool:
    return any(folder.rglob("compiled_one.one-*.nbc"))


def test_beside_the_byte_code_where_that_can_be_written(room: Path, tmp_path: Path) -> None:
    users = {"HOME": str(tmp_path / "home")}
    hits = [run(room, "compiled_one.py", **users).stdout for _ in range(2)]
    assert hits == ["0\n", "1\n"]
    assert kept_in(room / "__pycache__")
    assert not (tmp_path / "home").exists()


def test_functions_for_others_are_kept_for_those_to_come(room: Path) -> None:
    run(room, "compiled_one.py")
    told = [run(room, "compiled_one.py", "other").stdout.splitlines() for _ in range(2)]
    assert told[0] == ["no such step", "0 0 1"]
    assert told[1] == ["no such step", "1 0 0"]


@pytest.mark.parametrize(
    ("users", "place"),
    [
        ({"HOME": "home"}, "home/.cache/climbplan"),
        ({"HOME": "home", "XDG_CACHE_HOME": "own"}, "own/climbplan"),
        ({"HOME": "home", "NUMBA_CACHE_DIR": "named"}, "named"),
    ],
)
def test_in_the_users_cache_where_it_cannot(
    room: Path, tmp_path: Path, users: dict[str, str], place: str
) -> None:
    forbid_writing(room)
    there = {name: str(tmp_path / folder) for name, folder in users.items()}
    first, second = (run(room, "compiled_one.py", **there) for _ in range(2))
    assert (first.stdout, second.stdout) == ("0\n", "1\n")
    assert (first.stderr, second.stderr) == ("", "")
    assert kept_in(tmp_path / place)


def test_named_by_the_user_before_anything_else(room: Path, tmp_path: Path) -> None:
    run(room, "compiled_one.py", NUMBA_CACHE_DIR=str(tmp_path / "named"))
    assert kept_in(tmp_path / "named")
    assert not kept_in(room)


def test_nowhere_to_write_is_no_error(room: Path, tmp_path: Path) -> None:
    forbid_writing(room)
    (tmp_path / "home").mkdir()
    forbid_writing(tmp_path / "home")
    done = run(room, "compiled_one.py", HOME=str(tmp_path / "home"))
    assert (done.stdout, done.stderr) == ("0\n", "")


def told(session: Invocation, capsys: pytest.CaptureFixture[str]) -> str:
    """What a session says while two functions are compiled and one is called again."""
    one, other = numba.njit(lambda x: x + 1), numba.njit(lambda x: x - 1)
    compiling._TELLER.__init__()  # as in a process that has compiled nothing yet
    with plain_messages(session):
        assert (one(1), other(1), one(2)) == (2, 0, 3)
    return capsys.readouterr().err


def test_long_compilation_is_told_once(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(compiling, "LONG", 60.0)
    assert told(Invocation(), capsys) == ""
    monkeypatch.setattr(compiling, "LONG", 0.0)
    assert told(Invocation(), capsys).count("compiling functions") == 1
    assert told(Invocation(quiet=True), capsys) == ""


def test_python_hears_of_it_through_the_log(
    caplog: pytest.LogCaptureFixture,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(compiling, "LONG", 0.0)
    compiling._TELLER.__init__()
    with caplog.at_level(logging.INFO, "climbplan"):
        numba.njit(lambda x: 2 * x)(1)
    assert [record.name for record in caplog.records] == ["climbplan.compiling"]
    assert capsys.readouterr().err == ""


@pytest.mark.slow
def test_first_run_of_a_package_that_cannot_be_written(tmp_path: Path) -> None:
    """Installed by another user: the second run neither compiles nor says so."""
    copy, scene = tmp_path / "installed" / "climbplan", "specs/bookshelf_scene.yaml"
    shutil.copytree(PACKAGE, copy, ignore=shutil.ignore_patterns("__pycache__"))
    shutil.copytree(PACKAGE.parent / "specs", tmp_path / "specs")
    forbid_writing(copy.parent)
    where = {"HOME": str(tmp_path / "home"), "PYTHONPATH": str(copy.parent)}
    try:
        first, second = (
            run(tmp_path, "-m", "climbplan", "solve-bookshelf", scene, "-o", out, **where)
            for out in ("first", "second")
        )
    finally:
        allow_writing(copy.parent)
    assert first.stderr.count("compiling functions") == 1
    assert "compiling" not in second.stderr
    assert "warning" not in (first.stderr + second.stderr).lower()
    told = [
        [line for line in text.splitlines() if not line.startswith(("progress", "compil"))]
        for text in (first.stderr, second.stderr)
    ]
    assert len(told[0]) == len(told[1])
    assert any((tmp_path / "home" / ".cache" / "climbplan").rglob("*.nbc"))


_SHORT = """
import sys
from cart_pole import problem, springs
import climbplan

made = springs() if sys.argv[1] != "products" else problem()
found = climbplan.solve(
    made, {"start": [0.2, 0.05, 0.1, -0.2], "walls": [0.35, 0.4]}, time_limit=float(sys.argv[3]),
    method=sys.argv[2], gap=1e-2,
)
print(found.status)
"""


@pytest.mark.slow
@pytest.mark.parametrize(
    ("made", "method"),
    [("springs", "branch-and-bound"), ("products", "branch-and-bound"), ("springs", "benders")],
)
def test_compiling_does_not_count_towards_a_limit_of_time(
    made: str, method: str, tmp_path: Path
) -> None:
    where = os.pathsep.join([str(PACKAGE.parent), str(PACKAGE.parent / "specs")])
    environment = {"NUMBA_CACHE_DIR": str(tmp_path), "PYTHONPATH": where}
    done = run(tmp_path, "-c", _SHORT, made, method, "5", **environment)
    assert done.stdout == "optimal\n"


def test_files_that_the_tree_compiles_are_those_that_its_cache_is_named_after() -> None:
    room = PACKAGE / "solvers" / "mixed_integer"
    marks = ("@compiled", "mixed_integer.compiling import")
    with_code = {
        file.name for file in room.glob("*.py") if any(mark in file.read_text() for mark in marks)
    }
    assert with_code <= set(SOURCES)
    assert all((room / name).is_file() for name in SOURCES)
    # What they read from the room is named, too
    read = re.compile(r"from climbplan\.solvers\.mixed_integer\.(\w+) import")
    needed = {f"{name}.py" for file in SOURCES for name in read.findall((room / file).read_text())}
    assert needed <= set(SOURCES) | {"indicator_form.py"}  # of which only the type is read


def test_later_versions_of_numba_compile_by_their_own_passes() -> None:
    """What `joined_code` builds on may be gone from them; results do not depend on it."""
    own = numba.core.compiler.Compiler
    assert compiling.select_pipelines((99, 0)) == (own, own)
    assert own not in compiling.select_pipelines((0, 60))


CARRYING = """
import os, runpy, sys
from pathlib import Path
from climbplan import precompiled
precompiled.CARRIED = Path(os.environ["CARRIED"])
if "old" in sys.argv:
    precompiled._FEATURES = ("one of later processors",)
if "later" in sys.argv:
    from climbplan import compiling
    compiling._TESTED_VERSION = (0, 1)
runpy.run_path("compiled_one.py")
"""


def run_carrying(room: Path, home: Path, *arguments: str) -> str:
    """Return the cache hits of a run with the code of a wheel and no other."""
    environment = {"HOME": str(home), "CARRIED": str(home.parent / "wheel")}
    return run(room, "-c", CARRYING, *arguments, **environment).stdout


def test_code_of_a_wheel_is_taken_before_any_other(room: Path, tmp_path: Path) -> None:
    home, wheel = tmp_path / "home", tmp_path / "wheel"
    run(
        room,
        "compiled_one.py",
        **{precompiled.DESTINATION: str(wheel)},
    )
    stored = {file.name.partition("-")[0] for file in wheel.rglob("*.nbc")}
    assert stored == {"compiled_one.one"}  # functions that only compiled ones call are part of it
    shutil.rmtree(room / "__pycache__")
    forbid_writing(room)
    assert run_carrying(room, home) == "1\n"
    assert not list(home.rglob("*.nb?"))
    if precompiled.LEVEL != "generic":
        assert run_carrying(room, home, "old") == "0\n"  # a processor below the level
        assert list(home.rglob("*.nbc"))
    assert run_carrying(room, tmp_path / "later", "later") == "0\n"  # a later version of Numba
    allow_writing(room)
    file = room / "compiled_one.py"
    file.write_text(file.read_text().replace("x + STEPS[i]", "STEPS[i] + x"))
    assert run_carrying(room, tmp_path / "other_home") == "0\n"


def test_functions_run_in_python_where_numba_is_disabled(room: Path, tmp_path: Path) -> None:
    file = room / "compiled_one.py"
    file.write_text(ROOM.partition('if "other"')[0] + "print(one(1.0, 0))")
    environment = {precompiled.DESTINATION: str(tmp_path / "wheel"), "NUMBA_DISABLE_JIT": "1"}
    assert run(room, file.name, **environment).stdout == "2.0\n"


class Speaker:
    """What the hook reports to Hatchling."""

    def display_info(self, message: str) -> None:
        print(message)


def create_hook(folder: Path) -> PrecompilingHook:
    root = str(PACKAGE.parent)
    return PrecompilingHook(root, {}, None, None, str(folder), "wheel", Speaker())


@pytest.mark.merge
def test_hook_adds_what_its_examples_compile(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    command = "solve-bookshelf bookshelf_scene.yaml --method exact --no-report"
    monkeypatch.setattr(wheel_hook, "RUNS", {"book": command})
    hook, build = create_hook(tmp_path), {"force_include": {}}
    hook.initialize("standard", build)
    ((source, target),) = build.pop("force_include").items()
    assert PACKAGE.parent / target == precompiled.CARRIED
    assert build == {"pure_python": False, "infer_tag": True}
    functions = [file.name.split(".")[1] for file in Path(source).rglob("*.nbc")]
    assert functions
    assert not any(function.startswith("_") for function in functions)
    hook.finalize("standard", build, "")
    assert not Path(source).exists()


def test_hook_names_an_example_that_fails(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setattr(wheel_hook, "RUNS", {"book": "solve-bookshelf missing.yaml"})
    with pytest.raises(RuntimeError, match=r"(?s)solve-bookshelf missing\.yaml.*missing\.yaml: "):
        create_hook(tmp_path).initialize("standard", {"force_include": {}})


def test_hook_leaves_editable_installations_alone(tmp_path: Path) -> None:
    hook, build = create_hook(tmp_path), dict[str, object]()
    hook.initialize("editable", build)
    assert build == {}
    hook.finalize("editable", build, "")


def test_examples_of_the_hook_are_shipped() -> None:
    for command in wheel_hook.RUNS.values():
        name = command.split()[1]
        assert name.startswith("{outputs}") or (PACKAGE.parent / "specs" / name).is_file()
