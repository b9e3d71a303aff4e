"""Output directories: whole or absent, whatever happens to the process that writes them."""

from __future__ import annotations

import os
import random
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from climbplan.cli import output_directory
from climbplan.cli.output_directory import OutputDirectory, exchange
from climbplan.errors import UsageError

FILES = ("plan.h5", "report.json", "figures/a.png")


def write(directory: Path, content: str) -> None:
    for name in FILES:
        (directory / name).parent.mkdir(exist_ok=True)
        (directory / name).write_text(content)


def content_of(directory: Path) -> str:
    """What all files of a directory hold; fails if it is not whole."""
    contents = {(directory / name).read_text() for name in FILES}
    assert len(contents) == 1
    return contents.pop()


def names(directory: Path) -> list[str]:
    return sorted(entry.name for entry in directory.iterdir())


def test_appears_at_publish(tmp_path: Path) -> None:
    target = tmp_path / "outputs" / "climb"
    with OutputDirectory(target) as output:
        write(output.path, "1")
        assert not target.exists()
        output.publish()
        assert content_of(target) == "1"
    assert content_of(target) == "1"
    assert names(target.parent) == ["climb"]


def test_a_run_that_fails_leaves_nothing(tmp_path: Path) -> None:
    with OutputDirectory(tmp_path / "a" / "b" / "c") as output:
        write(output.path, "1")
    assert names(tmp_path) == []


def test_parents_in_use_are_left_alone(tmp_path: Path) -> None:
    with OutputDirectory(tmp_path / "a" / "b"):
        (tmp_path / "a" / "mine.txt").write_text("x")
    assert names(tmp_path / "a") == ["mine.txt"]


def test_a_finished_directory_is_kept_without_force(tmp_path: Path) -> None:
    target = tmp_path / "climb"
    target.mkdir()
    write(target, "old")
    with pytest.raises(UsageError, match="--force"), OutputDirectory(target):
        pass
    assert content_of(target) == "old"


@pytest.mark.parametrize("kernel_exchanges", [True, False])
def test_force_replaces_it_at_publish(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, kernel_exchanges: bool
) -> None:
    if not kernel_exchanges:
        monkeypatch.setattr(output_directory, "exchange", lambda first, second: False)
    target = tmp_path / "climb"
    target.mkdir()
    write(target, "old")
    (target / "trajectory.csv").write_text("from the old plan")
    with OutputDirectory(target, force=True) as output:
        write(output.path, "new")
        assert content_of(target) == "old"
        output.publish()
    assert content_of(target) == "new"
    assert "trajectory.csv" not in names(target)
    assert names(tmp_path) == ["climb"]


def test_force_never_replaces_what_is_no_output(tmp_path: Path) -> None:
    target = tmp_path / "home"
    target.mkdir()
    (target / "thesis.tex").write_text("years of work")
    with pytest.raises(UsageError, match="not replaced"), OutputDirectory(target, force=True):
        pass
    assert (target / "thesis.tex").exists()


def test_an_empty_directory_is_used(tmp_path: Path) -> None:
    target = tmp_path / "climb"
    target.mkdir()
    with OutputDirectory(target) as output:
        write(output.path, "1")
        output.publish()
    assert content_of(target) == "1"


def test_a_link_to_a_directory_stays_a_link(tmp_path: Path) -> None:
    (tmp_path / "big disk").mkdir()
    link = tmp_path / "climb"
    link.symlink_to(tmp_path / "big disk")
    with OutputDirectory(link) as output:
        write(output.path, "1")
        output.publish()
    assert link.is_symlink()
    assert content_of(link) == "1"


def test_targets_that_cannot_be(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "file").write_text("x")
    (tmp_path / "loop").symlink_to(tmp_path / "loop")
    monkeypatch.chdir(tmp_path)
    for target, fragment in (
        ("file", "is a file"),
        ("file/below", "cannot be written"),
        ("file/below/deeper", "cannot be written"),
        ("loop", "cannot be written"),
        ("x" * 300, "cannot be written"),
        (".", "current directory"),
        ("..", "current directory"),
        ("/", "current directory"),
        ("/proc/climb", "cannot be written"),
    ):
        with pytest.raises(UsageError, match=fragment), OutputDirectory(Path(target), force=True):
            pytest.fail("the planner would have run")
    assert names(tmp_path) == ["file", "loop"]


def test_a_full_disk_is_no_bug(tmp_path: Path) -> None:
    with pytest.raises(UsageError, match="No space left"), OutputDirectory(tmp_path / "climb"):
        raise OSError(28, "No space left on device")


def test_two_runs_at_once(tmp_path: Path) -> None:
    target = tmp_path / "climb"
    with OutputDirectory(target) as first:
        write(first.path, "first")
        with pytest.raises(UsageError, match="another run"), OutputDirectory(target):
            pass
        target.mkdir()
        write(target, "second")  # published by another process meanwhile
        with pytest.raises(UsageError, match="written it meanwhile"):
            first.publish()
    assert content_of(target) == "second"
    assert names(tmp_path) == ["climb"]


def dead_process() -> int:
    process = subprocess.Popen([sys.executable, "-c", ""])
    process.wait()
    return process.pid


def test_leftovers_of_a_process_that_nobody_asked_after_go(tmp_path: Path) -> None:
    """Dead, but still listed: as in containers whose first process reaps nothing."""
    dead = subprocess.Popen([sys.executable, "-c", ""])
    while Path(f"/proc/{dead.pid}/stat").read_bytes().rpartition(b")")[2].split()[0] != b"Z":
        time.sleep(0.01)
    left = tmp_path / f".climb.{dead.pid}.tmp"
    left.mkdir()
    with OutputDirectory(tmp_path / "climb"):
        assert not left.exists()
    dead.wait()


def test_leftovers_of_dead_processes_go(tmp_path: Path) -> None:
    dead = dead_process()
    stale = [f".climb.{dead}.tmp", f".climb.{os.getpid()}.tmp"]  # the second: a recycled number
    kept = [f".climb.{os.getppid()}.tmp", f".other.{dead}.tmp", ".climb.x.tmp"]
    for name in (*stale, *kept):
        (tmp_path / name).mkdir()
    with OutputDirectory(tmp_path / "climb"):
        pass
    assert names(tmp_path) == sorted(kept)


def test_a_directory_set_aside_by_a_dead_process_comes_back(tmp_path: Path) -> None:
    aside = tmp_path / f".climb.{dead_process()}.old"
    aside.mkdir()
    write(aside, "old")
    with pytest.raises(UsageError, match="already exists"), OutputDirectory(tmp_path / "climb"):
        pass
    assert content_of(tmp_path / "climb") == "old"
    assert names(tmp_path) == ["climb"]


def test_exchange(tmp_path: Path) -> None:
    (tmp_path / "a").mkdir()
    (tmp_path / "b").mkdir()
    (tmp_path / "a" / "x").touch()
    if not exchange(tmp_path / "a", tmp_path / "b"):
        pytest.skip("this file system cannot exchange")
    assert names(tmp_path / "b") == ["x"]
    with pytest.raises(OSError, match="No such file"):
        exchange(tmp_path / "a", tmp_path / "none")


# Writes its output again and again, slowly, each time all files with the same new content.
SLOW_WRITER = """
import sys, time
from itertools import count
from pathlib import Path
from climbplan.cli import output_directory
target = Path(sys.argv[1])
if sys.argv[2] == "rename":
    output_directory.exchange = lambda first, second: False
print("ready", flush=True)
for number in count():
    with output_directory.OutputDirectory(target, force=True) as output:
        for name in ("plan.h5", "report.json", "figures/a.png"):
            (output.path / name).parent.mkdir(exist_ok=True)
            with (output.path / name).open("w") as stream:
                for piece in f"{sys.argv[3]} {number}".split(" "):
                    stream.write(piece + " ")
                    stream.flush()
                    time.sleep(0.0005)
        output.publish()
"""


@pytest.mark.parametrize("how", ["exchange", "rename"])
def test_killed_at_any_moment(tmp_path: Path, how: str) -> None:
    chance = random.Random(f"kill {how}")
    target = tmp_path / "climb"
    seen: set[str] = set()
    kills = 0
    while kills < 12 or (len(seen) < 4 and kills < 100):  # a busy machine publishes seldom
        kills += 1
        command = [sys.executable, "-c", SLOW_WRITER, str(target), how, str(kills)]
        with subprocess.Popen(command, stdout=subprocess.PIPE) as process:
            assert process.stdout is not None
            assert process.stdout.readline() == b"ready\n"
            time.sleep(chance.uniform(0.0, 0.08))
            process.send_signal(signal.SIGKILL)
        if target.exists():
            seen.add(content_of(target))
    assert len(seen) >= 4  # the kills did fall between publications
    with OutputDirectory(target, force=True) as output:
        write(output.path, "last")
        output.publish()
    assert content_of(target) == "last"
    assert names(tmp_path) == ["climb"]


KILLED_AT = """
import os, signal, sys
from pathlib import Path
from climbplan.cli import output_directory
target, moment, how = Path(sys.argv[1]), int(sys.argv[2]), sys.argv[3]
if how == "rename":
    output_directory.exchange = lambda first, second: False
calls = 0
def tick(event, arguments):
    global calls
    if event in ("os.rename", "os.remove", "os.rmdir", "os.mkdir", "open", "shutil.rmtree"):
        calls += 1
        if calls == moment:
            os.kill(os.getpid(), signal.SIGKILL)
with output_directory.OutputDirectory(target, force=True) as output:
    sys.addaudithook(tick)
    for name in ("plan.h5", "report.json", "figures/a.png"):
        (output.path / name).parent.mkdir(exist_ok=True)
        (output.path / name).write_text("new")
    output.publish()
"""


@pytest.mark.parametrize("how", ["exchange", "rename"])
def test_killed_at_every_step(tmp_path: Path, how: str) -> None:
    target = tmp_path / "climb"
    outcomes = []
    for moment in range(1, 100):
        with OutputDirectory(target, force=True) as output:
            write(output.path, "old")
            output.publish()
        assert names(tmp_path) == ["climb"]  # what the run before left is gone
        command = [sys.executable, "-c", KILLED_AT, str(target), str(moment), how]
        code = subprocess.run(command, check=False).returncode
        outcomes.append(content_of(target) if target.exists() else "absent")
        if code == 0:
            break
        assert code == -signal.SIGKILL
    assert outcomes[0] == "old"
    assert outcomes[-1] == "new"
    changes = [o for i, o in enumerate(outcomes) if i == 0 or o != outcomes[i - 1]]
    assert changes == (["old", "new"] if how == "exchange" else ["old", "absent", "new"])
