"""Scenes drawn for motions: the numbers of each, and the spec that they make."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from climbplan.arrays import Array
from climbplan.datasets.motions.walkers import GroundRobot
from climbplan.datasets.schema.motions import (
    AnyScene,
    BlocksSceneSpec,
    GroundScene,
    RubbleSceneSpec,
    ScansSceneSpec,
    SlopeSceneSpec,
    SpecSceneSpec,
    StairsSceneSpec,
    StonesSceneSpec,
)
from climbplan.errors import UsageError
from climbplan.scan.courses import (
    Course,
    make_blocks,
    make_rubble,
    make_slope,
    make_stairs,
    make_stones,
)
from climbplan.scan.meshes import read_mesh
from climbplan.schema.loaded import LoadedSpec
from climbplan.schema.loading import load_spec
from climbplan.schema.overrides import Override
from climbplan.schema.yaml_source import write_yaml

MESHES = (".stl", ".obj", ".ply")
NO_ROBOT = -1  # of scenes whose spec names it
_RANGE_KEYS = {  # keys of each family that one number is drawn of
    "stairs": ("rise", "run", "steps"),
    "steps": ("height", "run", "steps"),
    "slope": ("angle_deg", "length"),
    "stones": ("rows",),
    "rubble": ("rows",),
    "scans": ("length",),
}
_COUNTS = ("steps", "rows")
_DIGITS = 4  # of drawn numbers, so that specs can be read
_MESH = "terrain.stl"


@dataclass(frozen=True)
class SceneSample:
    """A scene of a row: everything that its spec follows from."""

    name: str  # of its files, unique
    scene: int
    robot: int  # NO_ROBOT where the scene's spec names it
    values: dict[str, float]  # by key
    seed: int  # of the details of the ground


@dataclass(frozen=True)
class SceneFamilies:
    """The scenes and robots of a spec; draws one of both for a row, and loads its spec."""

    scenes: tuple[AnyScene, ...]
    walkers: tuple[GroundRobot, ...]
    directory: Path  # that paths start from
    time_limit: float  # [s] of a planner

    @property
    def labels(self) -> tuple[str, ...]:
        """Names of the scenes, unique: their families, or the names of their specs."""
        names = [
            Path(scene.file).stem if isinstance(scene, SpecSceneSpec) else scene.family
            for scene in self.scenes
        ]
        counts = Counter(names)
        return tuple(
            f"{name}_{names[:k].count(name) + 1}" if counts[name] > 1 else name
            for k, name in enumerate(names)
        )

    @property
    def parameter_names(self) -> tuple[str, ...]:
        """Names of the numbers of a row: robot, scene, seed, then the drawn keys of all scenes."""
        keys = [
            f"{label}.{key}"
            for label, scene in zip(self.labels, self.scenes, strict=True)
            for key in _list_ranges(scene)
        ]
        return ("robot", "scene", "terrain_seed", *keys)

    def require_specs(self) -> None:
        """Raise SpecError for specs of scenes with a mistake, at either end of their ranges."""
        for k, scene in enumerate(self.scenes):
            if isinstance(scene, SpecSceneSpec):
                for end in (0, 1):
                    values = {key: interval[end] for key, interval in scene.ranges.items()}
                    self.load(SceneSample("", k, NO_ROBOT, values, 0), self.directory)

    def draw(self, rng: np.random.Generator) -> SceneSample:
        """Draw a scene, a robot and their numbers."""
        k = int(rng.integers(len(self.scenes)))
        scene = self.scenes[k]
        is_stated = isinstance(scene, SpecSceneSpec)
        robot = NO_ROBOT if is_stated else int(rng.integers(len(self.walkers)))
        values = {
            key: _draw_number(rng, key, low, high)
            for key, (low, high) in _list_ranges(scene).items()
        }
        seed = int(rng.integers(2**31))
        who = "" if is_stated else f"{_format_name(self.walkers[robot].name)}_"
        name = f"{who}{self.labels[k]}_{int(rng.integers(2**63)):016x}"
        return SceneSample(name, k, robot, values, seed)

    def encode(self, sample: SceneSample) -> Array:
        """Return the numbers of a scene, as `parameter_names`; 0 for those of other scenes."""
        numbers = [float(sample.robot), float(sample.scene), float(sample.seed)]
        for k, scene in enumerate(self.scenes):
            values = sample.values if k == sample.scene else {}
            numbers += [values.get(key, 0.0) for key in _list_ranges(scene)]
        return np.array(numbers)

    def load(self, sample: SceneSample, folder: Path) -> LoadedSpec:
        """Write what a drawn scene needs into a folder, and return its spec.

        Raises:
            SpecError: The spec has mistakes, or nothing can stand on its ground.
            UsageError: The spec is of a kind that moves no robot, or a folder has no meshes.
        """
        scene = self.scenes[sample.scene]
        if isinstance(scene, SpecSceneSpec):
            options = [Override.of(key, v, f"ranges.{key}") for key, v in sample.values.items()]
            options.append(Override.of("solver.time_limit", self.time_limit, "solver.time_limit"))
            loaded = load_spec(self.directory / scene.file, options)
        else:
            loaded = load_spec(self._write_ground_spec(scene, sample, folder))
        if not isinstance(loaded, LoadedSpec):
            raise UsageError(f"{self.labels[sample.scene]}: expected a spec that a robot moves by")
        return loaded

    def _write_ground_spec(self, scene: GroundScene, sample: SceneSample, folder: Path) -> Path:
        walker = self.walkers[sample.robot]
        if isinstance(scene, ScansSceneSpec):
            mesh, route = self._select_scan(scene, sample, walker)
        else:
            course = make_course(scene, sample.values, sample.seed)
            course.write(folder / _MESH)
            mesh, route = _MESH, np.array([[walker.start, 0.0], [course.length, course.rise]])
        robot = walker.file
        if walker.text:
            robot = "robot.yaml"
            (folder / robot).write_text(walker.text, encoding="utf-8")
        terrain = {"friction": sample.values["friction"], "scan": {"file": mesh}}
        spec = walker.build_spec(robot, terrain, route, self.time_limit)
        path = folder / f"{sample.name}.yaml"
        path.write_text(write_yaml(spec), encoding="utf-8")
        return path

    def _select_scan(
        self, scene: ScansSceneSpec, sample: SceneSample, walker: GroundRobot
    ) -> tuple[str, Array]:
        """Return the mesh that the seed selects, and the way over it."""
        files = list_meshes(self.directory / scene.folder)
        path = files[sample.seed % len(files)]
        mesh = read_mesh(path)
        corners = mesh.vertices[mesh.triangles]
        along = [walker.start, walker.start + sample.values["length"]]
        return str(path.absolute()), np.array([[y, measure_height(corners, y)] for y in along])


def list_meshes(folder: Path) -> list[Path]:
    """Return the meshes of a folder by name; raises UsageError if there is none."""
    if not folder.is_dir():
        raise UsageError(f"{folder}: no such folder, expected one with meshes")
    files = sorted(path for path in folder.iterdir() if path.suffix.lower() in MESHES)
    if not files:
        raise UsageError(f"{folder}: no mesh in it, expected files {', '.join(MESHES)}")
    return files


def measure_height(corners: Array, y: float) -> float:
    """Return the height of the highest triangle (F, 3, 3) over (0, y) [m].

    Raises:
        UsageError: No triangle is there.
    """
    edges = corners[:, [1, 2], :2] - corners[:, :1, :2]
    area = edges[:, 0, 0] * edges[:, 1, 1] - edges[:, 0, 1] * edges[:, 1, 0]
    is_seen = np.abs(area) > 0  # from above
    edges, area, first = edges[is_seen], area[is_seen], corners[is_seen, 0]
    d = np.array([0.0, y]) - first[:, :2]
    v = (d[:, 0] * edges[:, 1, 1] - d[:, 1] * edges[:, 1, 0]) / area
    w = (edges[:, 0, 0] * d[:, 1] - edges[:, 0, 1] * d[:, 0]) / area
    is_over = (v >= 0) & (w >= 0) & (v + w <= 1)
    if not is_over.any():
        raise UsageError(f"no ground at (0, {y:g}), where the way leads")
    triangles = corners[is_seen][is_over]
    weights = np.stack([1 - v - w, v, w], axis=1)[is_over]
    return float((triangles[:, :, 2] * weights).sum(axis=1).max())


def make_course(scene: GroundScene, values: dict[str, float], seed: int) -> Course:
    """Return the ground of a drawn scene."""
    rng = np.random.default_rng(seed)
    match scene:
        case StairsSceneSpec():
            return make_stairs(values["rise"], values["run"], int(values["steps"]))
        case BlocksSceneSpec():
            return make_blocks(rng, values["run"], int(values["steps"]), values["height"])
        case SlopeSceneSpec():
            return make_slope(float(np.deg2rad(values["angle_deg"])), values["length"])
        case StonesSceneSpec():
            return make_stones(rng, int(values["rows"]), scene.size)
        case RubbleSceneSpec():
            tilt = float(np.deg2rad(scene.tilt_deg))
            return make_rubble(rng, int(values["rows"]), scene.height, tilt)
    raise AssertionError(f"no ground of {scene.family}")


def _list_ranges(scene: AnyScene) -> dict[str, tuple[float, float]]:
    """Return the ranges of the numbers that are drawn for a scene."""
    if isinstance(scene, SpecSceneSpec):
        return dict(scene.ranges)
    return {key: getattr(scene, key) for key in ("friction", *_RANGE_KEYS[scene.family])}


def _draw_number(rng: np.random.Generator, key: str, low: float, high: float) -> float:
    if key in _COUNTS:
        return float(rng.integers(int(low), int(high) + 1))
    return round(float(rng.uniform(low, high)), _DIGITS)


def _format_name(name: str) -> str:
    return "".join(letter if letter.isalnum() else "_" for letter in name.lower())


def list_scene_files(scenes: Sequence[AnyScene], directory: Path) -> list[Path]:
    """Return the files that scenes are made from: specs, and meshes of folders."""
    files: list[Path] = []
    for scene in scenes:
        if isinstance(scene, SpecSceneSpec):
            files.append(directory / scene.file)
        elif isinstance(scene, ScansSceneSpec):
            files += list_meshes(directory / scene.folder)
    return files
