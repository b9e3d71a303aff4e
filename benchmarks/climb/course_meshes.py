"""Courses of the benchmark, drawn from seeds: stairs, rubble and stepping stones along y."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np

from climbplan.scan.courses import Course, make_rubble, make_stairs, make_stones

_NUM_COLUMNS = 12  # of blocks of rubble side by side


def draw_stairs(seed: int) -> Course:
    """Draw 3 to 8 steps, 0.08 to 0.17 m high and 0.25 to 0.35 m deep."""
    draw = np.random.default_rng(seed)
    rise, run, count = draw.uniform(0.08, 0.17), draw.uniform(0.25, 0.35), int(draw.integers(3, 9))
    return make_stairs(rise, run, count)


def draw_rubble(seed: int) -> Course:
    """Draw 100 to 500 blocks of uneven height, each inclined by up to 8 degrees twice."""
    draw = np.random.default_rng(1000 + seed)
    num_rows = max(int(draw.integers(100, 501)) // _NUM_COLUMNS, 8)
    return make_rubble(draw, num_rows, (-0.04, 0.08), np.deg2rad(8))


def draw_stones(seed: int) -> Course:
    """Draw 4 to 8 rows of six stones of 0.14 to 0.2 m, apart from each other and uneven."""
    draw = np.random.default_rng(2000 + seed)
    return make_stones(draw, int(draw.integers(4, 9)), (0.14, 0.2))


COURSES: dict[str, Callable[[int], Course]] = {
    "stairs": draw_stairs,
    "rubble": draw_rubble,
    "stones": draw_stones,
}


def write_course(kind: str, seed: int, folder: Path) -> tuple[Path, Course]:
    """Write the mesh of a course; return its file and the course."""
    course = COURSES[kind](seed)
    path = folder / f"{kind}{seed}.stl"
    course.write(path)
    return path, course
