"""A command that does not heed signals, or dies: what the process above it does."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

import climbplan

ROOT = Path(climbplan.__file__).parents[1]
START = """
import hashlib, os, signal, subprocess, sys, threading, time
from pathlib import Path
from climbplan.cli.interrupts import interrupt_handled
from climbplan.cli.output_directory import OutputDirectory
from climbplan.cli.supervision import run_supervised

def ready():
    print("ready", flush=True)

def deaf():
    "Compiled code that is busy for many minutes, and ready only when it is."
    def tell():
        # then waits for the interpreter, which the main thread lets go just once
        time.sleep(0.01)
        ready()
    sys.setswitchinterval(1e6)
    threading.Thread(target=tell, daemon=True).start()
    hashlib.pbkdf2_hmac("sha256", b"", b"", 2**31 - 1)

def inside(do):
    def command():
        with OutputDirectory(Path("below/deeper/out")) as directory:
            (directory.path / "half").write_text("written")
            if do is not deaf:
                ready()
            do()
            directory.publish()
        return 0
    return command
"""


def start(
    folder: Path, script: str, deaf_to: signal.Signals | None = None
) -> subprocess.Popen[str]:
    """A script that has come to `ready()`."""

    def handlers() -> None:
        # Whoever runs the tests may ignore some: a shell in the background, nohup
        for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
            signal.signal(number, signal.SIG_DFL)
        if deaf_to is not None:
            signal.signal(deaf_to, signal.SIG_IGN)

    run = subprocess.Popen(
        [sys.executable, "-c", START + script],
        cwd=folder,
        env={**os.environ, "PYTHONPATH": str(ROOT)},
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
        preexec_fn=handlers,
    )
    assert run.stdout is not None
    assert run.stdout.readline() == "ready\n"
    return run


def finish(run: subprocess.Popen[str]) -> tuple[int, str, str]:
    out, told = run.communicate(timeout=60)
    return run.returncode, out, told


@pytest.mark.parametrize(
    ("number", "code", "word"),
    [
        (signal.SIGINT, 130, "interrupted\n"),
        (signal.SIGTERM, 143, "terminated\n"),
        (signal.SIGHUP, 129, "hung up\n"),
    ],
)
def test_compiled_code_that_does_not_return(
    tmp_path: Path, number: signal.Signals, code: int, word: str
) -> None:
    run = start(tmp_path, "sys.exit(run_supervised(inside(deaf)))")
    begin = time.monotonic()
    run.send_signal(number)
    assert finish(run) == (code, "", word)
    # 1.4 s of grace; the rest is what a busy machine needs to end a process
    assert time.monotonic() - begin < 20.0
    assert not list(tmp_path.iterdir())


def test_what_the_command_had_started_goes_with_it(tmp_path: Path) -> None:
    script = """
def both():
    child = subprocess.Popen([sys.executable, "-c", "import time; time.sleep(60)"])
    print(child.pid, flush=True)
    deaf()

sys.exit(run_supervised(lambda: both() or 0))
"""
    run = subprocess.Popen(
        [sys.executable, "-c", START + script],
        cwd=tmp_path,
        env={**os.environ, "PYTHONPATH": str(ROOT)},
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        text=True,
    )
    assert run.stdout is not None
    started = int(run.stdout.readline())
    assert run.stdout.readline() == "ready\n"
    run.send_signal(signal.SIGTERM)
    run.communicate(timeout=60)
    assert not Path(f"/proc/{started}").exists()


def test_a_crash_leaves_nothing_behind(tmp_path: Path) -> None:
    run = start(tmp_path, "sys.exit(run_supervised(inside(os.abort)))")
    code, _, told = finish(run)
    assert code == 128 + signal.SIGABRT
    assert told == "internal error: the process crashed (SIGABRT); nothing was written\n"
    assert not list(tmp_path.iterdir())


def test_killed_for_want_of_memory(tmp_path: Path) -> None:
    run = start(tmp_path, "sys.exit(run_supervised(inside(lambda: os.kill(os.getpid(), 9))))")
    code, _, told = finish(run)
    assert code == 128 + signal.SIGKILL
    assert told.startswith("killed (SIGKILL), perhaps because memory ran out")
    assert not list(tmp_path.iterdir())


def test_the_command_goes_with_the_process_above_it(tmp_path: Path) -> None:
    run = start(tmp_path, "sys.exit(run_supervised(inside(deaf)))")
    (child,) = Path(f"/proc/{run.pid}/task/{run.pid}/children").read_text().split()
    run.kill()
    run.communicate(timeout=60)
    end = time.monotonic() + 20.0
    while Path(f"/proc/{child}").exists() and time.monotonic() < end:
        time.sleep(0.01)
    assert not Path(f"/proc/{child}").exists()


def test_what_was_published_stays_and_the_exit_code_is_the_commands_own(tmp_path: Path) -> None:
    run = start(
        tmp_path, "run_supervised(inside(lambda: None)); sys.exit(run_supervised(lambda: 5))"
    )
    assert finish(run)[0] == 5
    assert (tmp_path / "below" / "deeper" / "out" / "half").read_text() == "written"


def test_other_files_in_a_new_parent_stay(tmp_path: Path) -> None:
    script = """
def crash():
    Path("below/own").write_text("kept")
    os.abort()

sys.exit(run_supervised(inside(crash)))
"""
    finish(start(tmp_path, script))
    assert [str(p.relative_to(tmp_path)) for p in tmp_path.rglob("*")] == ["below", "below/own"]


def test_an_ignored_ctrl_c_stays_ignored(tmp_path: Path) -> None:
    script = "sys.exit(run_supervised(inside(lambda: time.sleep(1.0))))"
    run = start(tmp_path, script, deaf_to=signal.SIGINT)
    run.send_signal(signal.SIGINT)
    assert finish(run)[0] == 0


def test_an_interrupt_that_is_dropped_comes_again(tmp_path: Path) -> None:
    """As CasADi drops exceptions; a second Ctrl-C does not disturb what the first one began."""
    script = """
from climbplan.cli import supervision
supervision.GRACE = 60.0  # so that a busy machine sees it too

def command():
    for turn in range(3):
        try:
            if turn == 0:
                ready()
            time.sleep(60)
        except KeyboardInterrupt as stop:
            print(type(stop).__name__, flush=True)
            os.kill(os.getpid(), signal.SIGTERM)
            time.sleep(0.3)  # three times as long as it takes to come again
    interrupt_handled()
    time.sleep(0.3)
    return 7

sys.exit(run_supervised(command))
"""
    run = start(tmp_path, script)
    run.send_signal(signal.SIGTERM)
    assert finish(run) == (7, "Terminated\n" * 3, "")


def test_an_error_that_a_library_made_of_an_interrupt_is_one(tmp_path: Path) -> None:
    script = """
import typer
from climbplan.cli import app

@app.app.command()
def swallow():
    try:
        ready()
        time.sleep(60)
    except KeyboardInterrupt:
        pass
    raise RuntimeError("wrong number or type of arguments")

sys.exit(run_supervised(lambda: app.run(["swallow"])))
"""
    run = start(tmp_path, script)
    run.send_signal(signal.SIGINT)
    assert finish(run) == (130, "", "interrupted\n")
