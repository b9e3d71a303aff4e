"""Run mutants, each in a process of its own, and judge how the commands that read them end.

By hand: `python tests/cli/mutation_runs.py PLANS FOLDER SEED COUNT [WORD]` makes and runs mutants
(those whose name holds WORD), with the plans in PLANS, which are made there if they are missing.
PYTHONPATH: the checkout, tests/cli and tests/learning.
"""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import Any, Self

from mutation_cases import PLANS, QUICK_PLANS, ROOT, SPECS, Case, cases, names_of_plans, prepared

MAX_SECONDS = 10.0  # [s] of CPU that a command may take for a mutant
MAX_MEMORY = 2 * 2**30  # [bytes]


@dataclass(frozen=True)
class Outcome:
    """How one command ended with a mutant."""

    case: Case
    changed: str
    command: str
    code: int  # -1: an exception came through; -2: it ended by a signal; -3: did not end
    seconds: float  # of CPU
    message: str  # end of standard error
    memory: int = 0  # [bytes] largest size of the process

    @property
    def is_bug(self) -> bool:
        """Whether it ended as nothing may end."""
        is_bad_end = self.code in (-1, -2, -3, 1) or "Traceback" in self.message
        return is_bad_end or self.seconds > MAX_SECONDS or self.memory > MAX_MEMORY

    def __str__(self) -> str:
        tail = self.message.strip().splitlines()[-2:]
        end = f"exit {self.code}, {self.seconds:.1f} s, {self.memory / 2**20:.0f} MiB"
        return f"{self.case.name} ({self.changed}): {self.command}: {end}: {' '.join(tail)}"


class Runner:
    """Context: makes mutants, and has a warm process fork a child for each command.

    The commands are loaded, and what they compile is there, before the first child is forked.
    """

    def __init__(self, folder: Path, plans: Mapping[str, Path]) -> None:
        self.folder = folder
        self.plans = plans
        self.sources = folder.parent / "sources"
        tests = Path(__file__).parent
        folders = (str(ROOT), str(tests), str(tests.parent / "learning"))
        self._server = subprocess.Popen(
            [sys.executable, str(tests / "mutation_worker.py")],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
            env={**os.environ, "PYTHONPATH": os.pathsep.join(folders), "NO_COLOR": "1"},
        )
        self._count = 0
        self._send({"warm": self._whole_commands(), "folder": str(SPECS)})
        for name, path in plans.items():
            if not path.exists():
                _make_plan(name, path.parent)
            assert path.exists(), name

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._server.kill()
        self._server.communicate()

    def outcomes(self, case: Case) -> list[Outcome]:
        """Return what comes of one mutant; its folder stays where something is wrong."""
        self._count += 1
        folder = self.folder / f"{self._count:04d}"
        folder.mkdir(parents=True)
        changed, commands = prepared(case, folder, self.plans, self.sources)
        outcomes = [
            Outcome(
                case,
                changed,
                f"cd {folder} && climbplan {' '.join(command)}",
                **self._send({"folder": str(folder), "command": command}),
            )
            for command in commands
        ]
        if not any(outcome.is_bug for outcome in outcomes):
            shutil.rmtree(folder)
        return outcomes

    def _send(self, request: dict[str, Any]) -> dict[str, Any]:
        """Send one line to the server and return its answer."""
        assert self._server.stdin is not None
        assert self._server.stdout is not None
        self._server.stdin.write(json.dumps(request) + "\n")
        self._server.stdin.flush()
        answer: dict[str, Any] = json.loads(self._server.stdout.readline())
        return answer

    def _whole_commands(self) -> list[list[str]]:
        """Commands on whole files: what they load and compile is no mutant's fault."""
        sources = self.sources
        commands = [
            ["!sources", str(sources)],
            ["validate", "climb_tube.yaml", "mpc_forward.yaml", "robot_telescope.yaml"],
            ["fit-terrain", str(sources / "mesh.stl"), "-o", str(sources / "fit"), "--force"],
            ["fit-stiffness", "limb_test.csv", "-o", str(sources / "stiffness"), "--force"],
            ["verify", str(sources / "proof.h5")],
            ["verify", str(sources / "model.h5")],
        ]
        for name in QUICK_PLANS:
            path = self.plans[name]
            commands += [] if path.exists() else [_plan_command(name, path.parent)]
            commands += [["report", str(path), "--json"], ["view", str(path), "--no-browser"]]
        return commands


def plan_paths(folder: Path, names: tuple[str, ...]) -> dict[str, Path]:
    """Return where a plan of each kind is below a folder, by name; `Runner` makes those missing."""
    return {
        name: folder / name / ("dataset.h5" if name.startswith("dataset") else "plan.h5")
        for name in names
    }


def _plan_command(name: str, folder: Path) -> list[str]:
    """Return the command that makes a plan in a folder."""
    command = [*PLANS[name], "-o", str(folder), "-q", "--force"]
    return [*command, "--no-report"] if command[0].startswith("plan-") else command


def _make_plan(name: str, folder: Path) -> None:
    """Make a plan in a folder, in a process of its own."""
    subprocess.run(
        [sys.executable, "-m", "climbplan", *_plan_command(name, folder)],
        cwd=SPECS,
        check=False,  # 5 where a plan is not verified: it is a plan all the same
        stdout=subprocess.DEVNULL,
        env={**os.environ, "PYTHONPATH": str(ROOT)},
    )


def main() -> None:
    """Make and run mutants by hand."""
    folder, seed, count = Path(sys.argv[2]).resolve(), int(sys.argv[3]), int(sys.argv[4])
    plans = plan_paths(Path(sys.argv[1]).resolve(), names_of_plans(count))
    word = sys.argv[5] if len(sys.argv) > 5 else ""
    codes: Counter[int] = Counter()
    with Runner(folder, plans) as runner:
        for case in cases(seed, count, plans):
            if word not in case.name:
                continue
            for outcome in runner.outcomes(case):
                codes[outcome.code] += 1
                if outcome.is_bug:
                    print(outcome, flush=True)
    print(dict(codes))


if __name__ == "__main__":
    main()
