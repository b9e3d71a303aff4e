"""Random rooms: drawn alike for the same seed, and told honestly in the table of the benchmark."""

from __future__ import annotations

import io
import json

import pytest

from benchmarks.limms.random_rooms import MASS, MOST_OBSTACLES, kind_of, random_room
from benchmarks.limms.room_table import counts
from benchmarks.limms.run import LimmsOptions, LimmsResult, as_json, bench_limms, write_text
from benchmarks.limms.trial import Trial
from climbplan.errors import UsageError
from climbplan.limms.scene.limms_scene import build_scene


def test_rooms_differ_and_repeat() -> None:
    assert random_room(3).text == random_room(3).text
    rooms = [random_room(seed).spec for seed in range(9)]
    assert len({room.box.goal for room in rooms}) == len(rooms)
    assert {room.title for room in rooms} == {"goal near", "goal far", "goal high"}
    assert len({len(room.modules) for room in rooms}) > 2
    assert {len(room.terrain.obstacles) for room in rooms} >= {0, MOST_OBSTACLES}
    assert all(MASS[0] <= room.box.mass <= MASS[1] for room in rooms)
    high = [room for seed, room in enumerate(rooms) if kind_of(seed) == "high"]
    assert all(room.box.goal[2] - room.box.start[2] >= 0.7 - 1e-3 for room in high)


def test_turned_rooms_are_the_same_with_a_yaw() -> None:
    for seed in (0, 1, 5):
        plain, turned = random_room(seed).spec, random_room(seed, turned=True).spec
        assert turned.title == f"{plain.title}, turned"
        assert abs(turned.box.goal_yaw_deg) > 1
        yaw = {"goal_yaw_deg": 0.0}
        assert turned.box.model_copy(update=yaw) == plain.box
        assert turned.terrain == plain.terrain
        assert turned.modules == plain.modules


def test_obstacles_of_rooms_are_solid() -> None:
    seed = next(s for s in range(9) if random_room(s).spec.terrain.obstacles)
    loaded = random_room(seed)
    scene = build_scene(loaded)
    blocks = [(o.lower, o.upper) for o in loaded.spec.terrain.obstacles]
    assert len(scene.solids) >= 6 + len(blocks)


def test_benchmark_tells_found_and_refused() -> None:
    told = io.StringIO()
    result = bench_limms(LimmsOptions(methods="rooms", count=1), out=told)
    assert not result.shipped
    assert not result.random
    out = io.StringIO()
    write_text(result, out)
    assert told.getvalue().startswith(out.getvalue())
    assert "processor time of this part" in told.getvalue()
    assert "found and verified: 100% of all" in out.getvalue()
    assert len(json.loads(json.dumps(as_json(result)))["rooms"]["rooms"]) == 1
    with pytest.raises(UsageError, match="modes, admm, admm-published, masses, rooms, turned"):
        bench_limms(LimmsOptions(methods="room"))


def test_refusals_are_told_by_what_they_prove() -> None:
    ends = ("verified", "infeasible", "not proved", "limit", "not verified")
    trials = tuple(
        Trial(f"room {k}", "modes", end, f"why {k}", "", 1.0, 1.0, {}, {}, None, "goal far", 1)
        for k, end in enumerate(ends)
    )
    assert list(counts(trials).values()) == [1, 1, 2, 1]
    out = io.StringIO()
    write_text(LimmsResult((), {}, {"rooms": trials}), out)
    text = out.getvalue()
    assert "20% of all, 25% of those that are not proved impossible" in text
    assert "room 1 (goal far), proved impossible: why 1" in text
    assert "room 3 (goal far), not found: why 3" in text
