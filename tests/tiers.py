"""Tiers of the tests by what they were measured to take, and the option that measures them.

`durations.json` holds, for each test function, the mean seconds of a case with its fixtures, those
of its module in full, those of the whole run not at all; what takes less than `WRITTEN` is left
out. A function beyond `EVERYDAY` is marked `merge`; one that is not listed runs every day.
"""

from __future__ import annotations

import json
import time
import zlib
from collections.abc import Generator
from pathlib import Path
from typing import Any

import pytest

DURATIONS = Path(__file__).with_name("durations.json")
WRITTEN = 0.05  # [s]
EVERYDAY = 0.8  # [s] the most that a case of an everyday test takes


def pytest_addoption(parser: pytest.Parser) -> None:
    group = parser.getgroup("climbplan")
    group.addoption("--seeds", type=int, default=3, help="of tests of random scenes [3]")
    group.addoption(
        "--slow-shard", default="0/1", metavar="K/N", help="slow tests: each N-th, from K mod N"
    )
    group.addoption(
        "--record-durations", action="store_true", help=f"store what tests take in {DURATIONS.name}"
    )


def pytest_configure(config: pytest.Config) -> None:
    if config.getoption("--record-durations"):
        config.pluginmanager.register(Recorder(config), "durations")


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Mark tests by their tier; deselect further seeds, and slow tests of other shards."""
    durations = json.loads(DURATIONS.read_text()) if DURATIONS.exists() else {}
    count = config.getoption("--seeds")
    shard, shards = (int(part) for part in config.getoption("--slow-shard").split("/"))
    seen: dict[str, list[int]] = {}
    kept, left = [], []
    for item in items:
        name = _function_of(item.nodeid)
        seconds = durations.get(name, 0.0)
        if seconds > EVERYDAY and item.get_closest_marker("slow") is None:
            item.add_marker("merge")
        params = dict(item.callspec.params) if hasattr(item, "callspec") else {}
        seed = params.pop("seed", None)
        test = f"{name}{params}"
        further = isinstance(seed, int) and _is_further(seed, seen.setdefault(test, []), count)
        elsewhere = zlib.crc32(item.nodeid.encode()) % shards != shard % shards
        other = elsewhere and item.get_closest_marker("slow") is not None
        (left if further or other else kept).append(item)
    items[:] = kept
    config.hook.pytest_deselected(items=left)


def _is_further(seed: int, before: list[int], count: int) -> bool:
    """Whether a seed follows `count` consecutive seeds of the same test.

    Seeds that follow none, of scenes that once failed, always run.
    """
    before.append(seed)
    row = 1
    while row < len(before) and before[-row - 1] == seed - row:
        row += 1
    return row > count


def _function_of(nodeid: str) -> str:
    return nodeid.partition("[")[0]


class Recorder:
    """Measures tests in each worker and writes them where the reports come together."""

    def __init__(self, config: pytest.Config) -> None:
        self.is_worker = hasattr(config, "workerinput")
        self.fixtures: dict[tuple[str, str], float] = {}  # [s] to set up, by place and name
        self.cases: dict[str, list[float]] = {}

    @pytest.hookimpl(wrapper=True)
    def pytest_fixture_setup(
        self, fixturedef: pytest.FixtureDef[Any]
    ) -> Generator[None, object, object]:
        start = time.perf_counter()
        try:
            return (yield)
        finally:
            if fixturedef.scope != "session":
                key = fixturedef.baseid, fixturedef.argname
                self.fixtures[key] = time.perf_counter() - start

    @pytest.hookimpl(wrapper=True)
    def pytest_runtest_makereport(
        self, item: pytest.Item, call: pytest.CallInfo[None]
    ) -> Generator[None, pytest.TestReport, pytest.TestReport]:
        report = yield
        is_slow = item.get_closest_marker("slow") is not None  # one case of a function may be
        if report.when == "call" and report.passed and not is_slow:
            used = item.fixturenames if isinstance(item, pytest.Function) else ()
            own = (
                seconds
                for (place, name), seconds in self.fixtures.items()
                if name in used and item.nodeid.startswith(place)
            )
            report.user_properties.append(("seconds", call.duration + sum(own)))
        return report

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        for key, value in report.user_properties if report.when == "call" else ():
            if key == "seconds" and isinstance(value, float):
                self.cases.setdefault(_function_of(report.nodeid), []).append(value)

    def pytest_sessionfinish(self) -> None:
        if self.is_worker:
            return
        durations = json.loads(DURATIONS.read_text()) if DURATIONS.exists() else {}
        for name, seconds in self.cases.items():
            mean = sum(seconds) / len(seconds)
            durations.pop(name, None)
            if mean >= WRITTEN:
                durations[name] = float(f"{mean:.2g}")
        functions = dict(sorted(durations.items()))
        DURATIONS.write_text(json.dumps(functions, indent=0) + "\n")
