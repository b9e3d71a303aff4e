"""The comparison: shipped scenes by both methods, random ones, and rooms drawn at random."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, TextIO

from climbplan.bench.limms.published import TABLE
from climbplan.bench.limms.room_table import write_rooms
from climbplan.bench.limms.table import write_beside, write_blocks, write_random
from climbplan.bench.limms.trial import METHODS, Trial, attempt
from climbplan.errors import UsageError
from climbplan.limms.random_jumps import random_jump
from climbplan.limms.random_rooms import random_room
from climbplan.limms.random_throws import random_throw
from climbplan.progress import Progress
from climbplan.spec.examples import example_text
from climbplan.spec.limms.loading import LoadedLimms, limms_of
from climbplan.spec.source import SourceText
from climbplan.spec.yaml_source import parse_yaml

# Beside the methods: rooms drawn at random, by the search over modes, without and with a turn
ROOMS = {"rooms": False, "turned": True}
RANDOM: dict[str, Callable[[int], LoadedLimms]] = {"throw": random_throw, "jump": random_jump}


@dataclass(frozen=True)
class LimmsOptions:
    """What is compared, and on how much."""

    seed: int = 0
    count: int = 30  # random throws, and as many jumps; 0: shipped scenes only
    seconds: float = 300.0  # limit of one plan
    methods: str = ",".join(METHODS)
    scenes: tuple[str, ...] = tuple(TABLE)


@dataclass(frozen=True)
class LimmsResult:
    """All trials; those of random scenes by their kind."""

    shipped: tuple[Trial, ...]
    random: dict[str, tuple[Trial, ...]]
    rooms: tuple[Trial, ...] = ()


def bench_limms(options: LimmsOptions, report: Progress = lambda stage, share: None) -> LimmsResult:
    """Plan everything, one after the other, methods in turn on each scene.

    Raises:
        UsageError: a method that is not known.
    """
    names = [name.strip() for name in options.methods.split(",") if name.strip()]
    known = (*METHODS, *ROOMS)
    if set(names) - set(known) or not names:
        raise UsageError(f"--methods: expected some of {', '.join(known)}, got {options.methods}")
    rooms = []
    for kind in (name for name in ROOMS if name in names):
        for number in range(options.count):
            report(kind, number / options.count)
            room = random_room(options.seed + number, ROOMS[kind])
            rooms.append(attempt(room, "modes", options.seconds))
    chosen = [method for method in METHODS if method in names]
    shipped = []
    for number, name in enumerate(options.scenes if chosen else ()):
        report("scenes", number / len(options.scenes))
        shipped += [attempt(_shipped(name), method, options.seconds) for method in chosen]
    found: dict[str, tuple[Trial, ...]] = {}
    for kind, draw in RANDOM.items() if chosen else ():
        trials = []
        for number in range(options.count):
            report(f"random {kind}", number / options.count)
            loaded = draw(options.seed + number)
            trials += [attempt(loaded, method, options.seconds) for method in chosen]
        found[kind] = tuple(trials)
    return LimmsResult(tuple(shipped), found, tuple(rooms))


def _shipped(name: str) -> LoadedLimms:
    text = example_text(name)
    return limms_of(parse_yaml(text, name), SourceText(name, name, Path.cwd(), text))


def as_json(result: LimmsResult, options: LimmsOptions) -> dict[str, Any]:
    """Everything as plain values."""
    return {
        "benchmark": "limms",
        "seed": options.seed,
        "time_limit": options.seconds,
        "shipped": [asdict(trial) for trial in result.shipped],
        "random": {kind: [asdict(t) for t in trials] for kind, trials in result.random.items()},
        "rooms": [asdict(trial) for trial in result.rooms],
        "published": {name: asdict(row) for name, row in TABLE.items()},
    }


def write_text(result: LimmsResult, out: TextIO) -> None:
    """All tables."""
    write_blocks(result.shipped, out)
    write_beside(result.shipped, out)
    for kind, trials in result.random.items():
        if trials:
            write_random(kind, trials, out)
    write_rooms(result.rooms, out)


def write_files(result: LimmsResult, options: LimmsOptions, directory: Path) -> None:
    """bench.json and bench.txt into a directory that exists."""
    text = json.dumps(as_json(result, options), indent=1, allow_nan=False)
    (directory / "bench.json").write_text(text + "\n", encoding="utf-8")
    with (directory / "bench.txt").open("w", encoding="utf-8") as file:
        write_text(result, file)
