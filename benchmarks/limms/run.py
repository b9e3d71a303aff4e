"""The comparison: shipped scenes by both methods, random ones, and rooms drawn at random."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import asdict, dataclass, field
from typing import Any, TextIO

from benchmarks.limms.delivered_table import write_delivered
from benchmarks.limms.published import TABLE
from benchmarks.limms.random_jumps import random_jump
from benchmarks.limms.random_rooms import random_room
from benchmarks.limms.random_throws import random_throw
from benchmarks.limms.room_table import write_rooms
from benchmarks.limms.shipped import MASSES, OTHERS, SEVEN, WITH_MASS, shipped_scene
from benchmarks.limms.table import write_beside, write_blocks, write_consensus, write_random
from benchmarks.limms.trial import METHODS, Method, Trial, attempt
from climbplan.errors import UsageError
from climbplan.limms.schema.loading import LoadedLimms
from climbplan.progress import Progress

# Beside the methods: rooms drawn at random, by the search over modes, without and with a turn
ROOMS = {"rooms": False, "turned": True}
RANDOM: dict[str, Callable[[int], LoadedLimms]] = {"throw": random_throw, "jump": random_jump}
COUNTS = {"throw": 30, "jump": 30, "rooms": 40, "turned": 30}
OF_CONSENSUS = 4  # of each random kind at most: its blocks take half a minute and more of a jump
# Seeds of each kind begin with the one of the run; turned rooms are others than those that are not
FIRST = {"turned": 40}


@dataclass(frozen=True)
class LimmsOptions:
    """What is compared, and on how much."""

    seed: int = 0
    count: int | None = None  # of each random kind [COUNTS]; 0: shipped scenes only
    seconds: float = 1000.0  # limit of one plan, which budgets of work end before
    methods: str = ",".join((*METHODS, MASSES, *ROOMS))
    scenes: tuple[str, ...] = (*SEVEN, *OTHERS)

    def drawn(self, kind: str) -> int:
        """How many of a random kind."""
        return COUNTS[kind] if self.count is None else self.count


@dataclass(frozen=True)
class LimmsResult:
    """All trials; those of random scenes by their kind."""

    shipped: tuple[Trial, ...]
    random: dict[str, tuple[Trial, ...]]
    rooms: dict[str, tuple[Trial, ...]] = field(default_factory=dict)
    masses: tuple[Trial, ...] = ()  # shipped scenes with masses


def bench_limms(
    options: LimmsOptions,
    report: Progress = lambda stage, share: None,
    out: TextIO | None = None,
) -> LimmsResult:
    """Plan everything, one after the other, methods in turn on each scene.

    out: where each table is written as soon as it is done, with the time that it took.

    Raises:
        UsageError: a method that is not known.
    """
    names = [name.strip() for name in options.methods.split(",") if name.strip()]
    known = (*METHODS, MASSES, *ROOMS)
    if set(names) - set(known) or not names:
        raise UsageError(f"--methods: expected some of {', '.join(known)}, got {options.methods}")
    chosen = [method for method in METHODS if method in names]
    shipped: list[Trial] = []
    found: dict[str, tuple[Trial, ...]] = {}
    rooms: dict[str, tuple[Trial, ...]] = {}
    masses: list[Trial] = []
    began = time.process_time()

    def told(part: LimmsResult) -> None:
        nonlocal began
        if out is not None:
            write_text(part, out)
            out.write(f"(processor time of this part: {time.process_time() - began:.0f} s)\n\n")
            out.flush()
        began = time.process_time()

    for number, name in enumerate(options.scenes if chosen else ()):
        report("scenes", number / len(options.scenes))
        shipped += [
            attempt(
                shipped_scene(name),
                method,
                options.seconds,
                _horizon(name, method),
                simulated=method == "modes",
            )
            for method in chosen
            if method == "modes" or name in TABLE
        ]
    if shipped:
        told(LimmsResult(tuple(shipped), {}))
    heavy = [name for name in options.scenes if name in WITH_MASS and MASSES in names]
    for number, name in enumerate(heavy):
        report("masses", number / len(heavy))
        given = ("massless=false", *WITH_MASS[name])
        scene = shipped_scene(name)
        masses.append(attempt(scene, "modes", options.seconds, given, simulated=True))
    if masses:
        told(LimmsResult((), {}, masses=tuple(masses)))
    for kind in (name for name in ROOMS if name in names):
        drawn = []
        for number in range(options.drawn(kind)):
            report(kind, number / options.drawn(kind))
            room = random_room(options.seed + FIRST.get(kind, 0) + number, ROOMS[kind])
            drawn.append(attempt(room, "modes", options.seconds))
        rooms[kind] = tuple(drawn)
        if drawn:
            told(LimmsResult((), {}, {kind: rooms[kind]}))
    for kind, draw in RANDOM.items() if chosen else ():
        trials: list[Trial] = []
        for number in range(options.drawn(kind)):
            report(f"random {kind}", number / options.drawn(kind))
            loaded = draw(options.seed + number)
            trials += [
                attempt(loaded, method, options.seconds)
                for method in chosen
                if method == "modes" or (method == "admm" and number < OF_CONSENSUS)
            ]
        found[kind] = tuple(trials)
        if trials:
            told(LimmsResult((), {kind: found[kind]}))
    return LimmsResult(tuple(shipped), found, rooms, tuple(masses))


def _horizon(name: str, method: Method) -> tuple[str, ...]:
    """The published form has the published number of intervals."""
    return (f"solver.admm.intervals={TABLE[name].steps}",) if method == "admm-published" else ()


def as_json(result: LimmsResult) -> dict[str, Any]:
    """Return all trials as plain values."""
    return {
        "shipped": [asdict(trial) for trial in result.shipped],
        "masses": [asdict(trial) for trial in result.masses],
        "random": {kind: [asdict(t) for t in trials] for kind, trials in result.random.items()},
        "rooms": {kind: [asdict(t) for t in trials] for kind, trials in result.rooms.items()},
        "published": {name: asdict(row) for name, row in TABLE.items()},
    }


def write_text(result: LimmsResult, out: TextIO) -> None:
    """All tables."""
    write_blocks(result.shipped, out)
    write_consensus(result.shipped, out)
    write_beside(result.shipped, out)
    massless = [trial for trial in result.shipped if trial.method == "modes"]
    write_delivered("massless", massless, out)
    write_delivered("with mass", result.masses, out)
    for kind, trials in result.random.items():
        if trials:
            write_random(kind, trials, out)
    for kind, trials in result.rooms.items():
        write_rooms(kind, trials, out)
