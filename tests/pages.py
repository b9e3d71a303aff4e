"""What pages say, taken at its word: their commands, code, files and outputs, run in order."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).parents[1]
_BLOCK = re.compile(r"^```(\w+)\n(.*?)^```$", re.DOTALL | re.MULTILINE)
_SAVED = re.compile(r"^# save as (\S+)$", re.MULTILINE)
_MARK = "=== block {} ==="


@dataclass(frozen=True)
class Block:
    """A fenced block of a page."""

    language: str
    text: str

    @property
    def file(self) -> str | None:
        """Where the reader is told to save it."""
        found = _SAVED.match(self.text)
        return found[1] if found else None


def blocks(page: str) -> list[Block]:
    """The fenced blocks of a page, in their order."""
    return [Block(language, text) for language, text in _BLOCK.findall(page)]


def shell_lines(page: str) -> list[str]:
    """The commands of a page, in their order."""
    return [
        line
        for block in re.findall(r"```sh\n(.*?)```", page, re.DOTALL)
        for line in block.splitlines()
        if line.strip() and not line.startswith("#")
    ]


def run(line: str, folder: Path) -> subprocess.CompletedProcess[str]:
    """A line in a folder that has the specs, with this environment's commands in front."""
    path = os.pathsep.join([str(Path(sys.executable).parent), os.environ["PATH"]])
    return subprocess.run(
        ["bash", "-c", line],
        cwd=folder,
        env={**os.environ, "PATH": path},
        capture_output=True,
        text=True,
        check=False,
    )


def script_of(page: str) -> str:
    """The page as one program: files are written, commands and code run, each told apart."""
    lines = ["import subprocess as _subprocess", "from pathlib import Path as _Path"]
    for k, block in enumerate(blocks(page)):
        if block.file is not None:
            lines.append(f"_Path({block.file!r}).write_text({block.text!r})")
            continue
        if block.language in ("sh", "python"):
            lines.append(f"print({_MARK.format(k)!r}, flush=True)")
        if block.language == "sh":
            lines += [
                f"_subprocess.run(['bash', '-c', {line!r}], check=True)"
                for line in shell_lines(f"```sh\n{block.text}```")
            ]
        elif block.language == "python":
            lines.append(block.text)
    return "\n".join(lines)


def outputs(printed: str) -> dict[int, str]:
    """What each block of `script_of` printed, by its number."""
    parts = re.split(_MARK.format(r"(\d+)") + r"\n", printed)
    return {int(k): text for k, text in zip(parts[1::2], parts[2::2], strict=True)}


def missing_lines(page: str, printed: str) -> list[str]:
    """Lines of the page's `text` blocks that the block before did not print.

    `...` in a line stands for anything: times, paths, digits that differ by machine.
    """
    told, missing, last = outputs(printed), [], -1
    for k, block in enumerate(blocks(page)):
        if block.language in ("sh", "python") and block.file is None:
            last = k
        elif block.language == "text":
            missing += [
                line for line in block.text.splitlines() if not _found(line, told.get(last, ""))
            ]
    return missing


def _found(line: str, printed: str) -> bool:
    pattern = r".*".join(re.escape(part.strip()) for part in line.split("..."))
    return re.search(pattern, printed) is not None
