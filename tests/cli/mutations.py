"""Mutations of every file that a command reads: specs, robot files, URDFs, tables and plan files.

Each mutant follows from its source and a number alone, so that what fails can be made again.
"""

from __future__ import annotations

import random
import re
from collections.abc import Iterator
from typing import Any

from climbplan.errors import SpecError
from climbplan.schema.yaml_source import parse_yaml, write_yaml

# As YAML: what no field expects, and what readers and solvers stumble over
HOSTILE = [
    "", "~", "true", "0", "-1", "1", "1e-300", "1e300", "-1e300", "1e9", "-1e9", "1e18", ".nan",
    ".inf", "-.inf", "-0.0", "9" * 400, "-" + "9" * 399, "0x" + "f" * 400, "0x1F", "0o17", "0b1",
    "!!int 0b101", "1:30", "1_000", "!!int 1:30", "!!float 1_0", "2024-01-01", "9" * 5000,
    "18446744073709551616", "4294967296", "2147483648", "0.1", "3.7", "[]", "{}", "[[]]", "[{}]",
    "[1, 2]", "[1, 2, 3]", "[.nan, 0, 0]", "[1e9, -1e9, 1e9]", "[0, 0, 0]", "[null]", "{a: 1}",
    "{lower: 1}", "x", "''", '"\\0"', '"\\ud800"', "'%s %d {0}'", "/", "..", "../../etc/passwd",
    "/dev/null", "/dev/zero", ".", "nowhere.yaml", "missing.h5", "'${x}'", "silvia", "scaler",
    "none", "\u00e9\u00df\u4e2d", "\uff14", "\U0001f600", "x" * 5000, "!!binary aGVsbG8=",
    "!!python/object:os.system x", "!!set {a}", "!x 1", "*a", "&a [*a]", "<<", "{<<: 1}", "? a",
    "- - - 1", "|\n  x", "'unclosed", "[1, 2", "@", "`", "%", "\t", "auto", "micp", "nlp", "exact",
]  # fmt: skip
_HOLE = "QQholeQQ"
Place = tuple[str | int, ...]


_NUMBER = re.compile(rb"-?\d+(?:\.\d+)?(?:[eE][-+]?\d+)?")
_NUMBERS = [
    b"0", b"-1", b"1", b"2", b"3.5", b"1e300", b"-1e300", b"1e-300", b"nan", b"inf", b"-inf",
    b"4294967295", b"2147483648", b"9223372036854775807", b"18446744073709551616", b"1e9",
    b"999999999999", b"9" * 400, b"9" * 6000, b"", b"x", b"(", b"[[[", b"'", b'"', b"{", b"\\",
]  # fmt: skip


def mutated_text(content: bytes, rng: random.Random) -> tuple[str, bytes]:
    """What was done to a text of any kind, and the outcome."""
    which = rng.choice(
        ["cut", "flip", "line out", "line twice", "insert", "swap", "encode", "number", "number"]
    )
    lines = content.splitlines(keepends=True)
    if which == "number" and (numbers := list(_NUMBER.finditer(content))):
        # Those of a header are more telling
        some = numbers[:24] if rng.random() < 0.5 else numbers
        found, other = rng.choice(some), rng.choice(_NUMBERS)
        changed = content[: found.start()] + other + content[found.end() :]
        return f"number at byte {found.start()}: {other[:20]!r}", changed
    at, row = rng.randrange(len(content)), rng.randrange(len(lines))
    if which == "cut":
        return f"cut at byte {at}", content[:at]
    if which == "flip":
        bytes_ = bytearray(content)
        places = [rng.randrange(len(content)) for _ in range(rng.randint(1, 4))]
        for place in places:
            bytes_[place] ^= 1 << rng.randrange(8)
        return f"bits changed at {places}", bytes(bytes_)
    if which == "line out":
        return f"line {row + 1} left out", b"".join(lines[:row] + lines[row + 1 :])
    if which == "line twice":
        return f"line {row + 1} doubled", b"".join([*lines[: row + 1], *lines[row:]])
    if which == "swap":
        other = rng.randrange(len(lines))
        lines[row], lines[other] = lines[other], lines[row]
        return f"lines {row + 1} and {other + 1} swapped", b"".join(lines)
    if which == "encode":
        encoding = rng.choice(["utf-16", "utf-16-be", "utf-32", "utf-32-le", "utf-7", "cp500"])
        return f"as {encoding}", content.decode("utf-8", "replace").encode(encoding, "replace")
    typed = rng.choice([b"\0", b"\xff\xfe", b"\t", b"'", b'"', b"{", b"]", b"<", b"&", b"%", b"\n"])
    return f"{typed!r} typed at byte {at}", content[:at] + typed * rng.randint(1, 3) + content[at:]


def mutated_yaml(content: bytes, rng: random.Random) -> tuple[str, bytes]:
    """What was done to a YAML file, and the outcome."""
    if rng.random() < 0.2:
        return mutated_text(content, rng)
    try:
        data = parse_yaml(content.decode(), "mutant").value
    except SpecError:  # text that was mutated before
        return mutated_text(content, rng)
    if not isinstance(data, dict):
        return mutated_text(content, rng)
    done, hostile = [], ""
    for _ in range(rng.choice([1, 1, 1, 2, 3])):
        places = list(_places(data))
        if not places:
            break
        place = rng.choice(places)
        holder: Any = data
        for segment in place[:-1]:
            holder = holder[segment]
        words, hostile = _changed(holder, place, rng, hostile)
        done.append(words)
    text = write_yaml(data).replace(f"'{_HOLE}'", _HOLE).replace(f'"{_HOLE}"', _HOLE)
    return "; ".join(done), text.replace(_HOLE, hostile).encode("utf-8", "surrogatepass")


def _changed(holder: Any, place: Place, rng: random.Random, hostile: str) -> tuple[str, str]:
    """What was done to the value at `place` of its holder; the YAML that takes the hole's place."""
    name, last = ".".join(map(str, place)), place[-1]
    value = holder[last]
    which = rng.choice(
        ["hostile"] * 5 + ["out", "retype", "scale", "scale", "longer", "shorter", "rename"]
    )
    if which == "hostile":
        hostile = hostile or rng.choice(HOSTILE)
        holder[last] = _HOLE
        return f"{name}: {hostile[:40]!r}", hostile
    if which == "scale" and isinstance(value, int | float) and not isinstance(value, bool):
        factor = rng.choice([-1, 0, 1e-9, 1e-3, 0.5, 1.001, 10, 1000, 1e6, 1e9])
        holder[last] = type(value)(value * factor)
        return f"{name} times {factor:g}", hostile
    if which == "longer" and isinstance(value, list) and value:
        holder[last] = [*value, *value[: rng.randint(1, len(value))]]
    elif which == "longer" and isinstance(value, dict):
        holder[last] = {**value, rng.choice(["x", "kind", "name", "friction", "1"]): 1}
    elif which == "shorter" and isinstance(value, list):
        holder[last] = value[: len(value) // 2]
    elif which == "shorter" and isinstance(value, dict):
        holder[last] = dict(list(value.items())[: len(value) // 2])
    elif which == "rename" and isinstance(holder, dict):
        holder[f"{last}x"] = holder.pop(last)
    elif which == "retype":
        holder[last] = rng.choice([[value], {"a": value}, str(value), [value] * 50, None])
    else:
        del holder[last]
        return f"{name} left out", hostile
    return f"{name} {which}", hostile


def _places(value: Any, path: Place = ()) -> Iterator[Place]:
    items = value.items() if isinstance(value, dict) else enumerate(value)
    for key, item in items:
        yield (*path, key)
        if isinstance(item, dict | list):
            yield from _places(item, (*path, key))


_ATTRIBUTE = re.compile(r'(\w+)="([^"]*)"')
_ELEMENT = re.compile(
    r"<(\w+)[^<>]*/>|<(inertial|collision|limit|origin)[^<>]*>.*?</\2>", re.DOTALL
)
_XML_HOSTILE = [
    "", " ", "0", "-1", "1e300", "-1e300", "1e-300", "nan", "INF", "-INF", "1_0", "0x4", "\uff14",
    " 1 ", "&#9;1&#10;", "1 2", "1 2 3", "1 2 3 4", "nan 0 0", "1e9 1e9 1e9", "0 0 0", "9" * 400,
    "a", "base_link", "L1_toe", "${x}", "$(find x)", "&lt;", "x" * 5000, "\u4e2d", "universe",
    "root_joint", "prismatic", "floating", "planar", "continuous", "fixed", "revolute", "100", "99",
]  # fmt: skip


def mutated_urdf(content: bytes, rng: random.Random) -> tuple[str, bytes]:
    """What was done to a URDF, and the outcome."""
    if rng.random() < 0.25:
        return mutated_text(content, rng)
    text = content.decode("utf-8", "replace")
    done = []
    for _ in range(rng.choice([1, 1, 2, 3])):
        which = rng.choice(["value", "value", "value", "scale", "attribute out", "out", "twice"])
        pattern = _ELEMENT if which in ("out", "twice") else _ATTRIBUTE
        found = list(pattern.finditer(text))
        if not found:
            break
        here = rng.choice(found)
        line = text.count("\n", 0, here.start()) + 1
        new = ""
        if which == "value":
            new = f'{here[1]}="{rng.choice(_XML_HOSTILE)}"'
        elif which == "scale":
            factor = rng.choice([-1.0, 0.0, 1e-6, 0.5, 10.0, 1e6])
            new = re.sub(r"[-\d.]*\d", lambda n, f=factor: _times(n[0], f), here[2])
            new = f'{here[1]}="{new}"'
        elif which == "twice":
            new = here[0] * 2
        text = text[: here.start()] + new + text[here.end() :]
        done.append(f"line {line}: {here[0][:40]} -> {new[:40]}")
    return "; ".join(done), text.encode("utf-8", "surrogatepass")


def _times(number: str, factor: float) -> str:
    try:
        return repr(float(number) * factor)
    except ValueError:
        return number
