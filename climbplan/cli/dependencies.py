"""What climbplan runs on, examined without importing any of it."""

from __future__ import annotations

import dataclasses
import shutil
from dataclasses import dataclass
from importlib.metadata import PackageNotFoundError, version
from importlib.util import find_spec
from pathlib import Path
from typing import Any


@dataclass(frozen=True)
class Dependency:
    """A library or program that climbplan uses."""

    name: str
    package: str  # as `pip install` knows it; "" for a program
    module: str  # as Python imports it, or the program's names separated by spaces
    purpose: str
    required: bool = True
    install: str = ""  # how, if not simply `pip install PACKAGE`
    wrong_versions: tuple[tuple[str, str], ...] = ()  # version, what is wrong with it


PARTS = (
    Dependency("trimesh", "trimesh", "trimesh", "meshes and clouds of `terrain.scan`"),
    Dependency("shapely", "shapely", "shapely", "contact regions of scans"),
    Dependency("Pillow", "pillow", "PIL", "pictures, height maps as PNG"),
    Dependency("DAQP", "daqp", "daqp", "posture nodes, force problems (default)"),
    Dependency("Clarabel", "clarabel", "clarabel", "force problems with exact cones"),
    Dependency("OSQP", "osqp", "osqp", "force problems, the published choice"),
    Dependency(
        "HiGHS",
        "highspy",
        "highspy",
        "mixed-integer linear form of stated programs",
        wrong_versions=(("1.14.0", "its presolve gives wrong answers"),),
    ),
    Dependency(
        "SCIP", "PySCIPOpt", "pyscipopt", "independent mixed-integer oracle (--solver scip)"
    ),
    Dependency("CasADi", "casadi", "casadi", "exact derivatives for --method nlp"),
    Dependency("IPOPT", "", "casadi/libcasadi_nlpsol_ipopt", "--method nlp; comes with CasADi"),
    Dependency("numpy", "numpy", "numpy", "arrays"),
    Dependency("scipy", "scipy", "scipy", "sparse matrices, hulls"),
    Dependency("h5py", "h5py", "h5py", "plan files"),
    Dependency("pydantic", "pydantic", "pydantic", "specs"),
    Dependency("PyYAML", "PyYAML", "yaml", "specs"),
    Dependency("typer", "typer", "typer", "command line"),
    Dependency("rich", "rich", "rich", "progress"),
    Dependency("numba", "numba", "numba", "compiled search of the bookshelf"),
    Dependency("scikit-learn", "scikit-learn", "sklearn", "training of strategies (fit-strategy)"),
    Dependency("joblib", "joblib", "joblib", "parallel studies (--jobs)"),
    Dependency("matplotlib", "matplotlib", "matplotlib", "figures"),
    Dependency("plotly", "plotly", "plotly", "interactive report"),
    Dependency("Jinja2", "jinja2", "jinja2", "pages of reports"),
    Dependency(
        "Gurobi",
        "gurobipy",
        "gurobipy",
        "posture problem (--solver gurobi); needs a licence, which is not looked for here",
        required=False,
        install="pip install 'climbplan[gurobi]'",
    ),
    Dependency("Knitro", "knitro", "knitro", "no command of this version uses it", required=False),
    Dependency(
        "CVXPY",
        "cvxpy",
        "cvxpy",
        "problems stated in it: `climbplan.CVXPY()`, `Program.from_cvxpy`",
    ),
    Dependency(
        "Pinocchio",
        "pin",
        "pinocchio",
        "robots from URDF files",
        required=False,
        install="pip install 'climbplan[urdf]'",
    ),
    Dependency(
        "fast-simplification",
        "fast-simplification",
        "fast_simplification",
        "shapes of robots from URDF files",
        required=False,
        install="pip install 'climbplan[urdf]'",
    ),
    Dependency(
        "pymunk",
        "pymunk",
        "pymunk",
        "physical bookshelf scenes of `gen-data`",
        required=False,
        install="pip install 'climbplan[data]'",
    ),
    Dependency(
        "Dask",
        "distributed",
        "distributed",
        "`gen-data --scheduler`",
        required=False,
        install="pip install 'climbplan[cluster]'",
    ),
    Dependency(
        "pyarrow",
        "pyarrow",
        "pyarrow",
        "Parquet of `data export`",
        required=False,
        install="pip install 'climbplan[data]'",
    ),
    Dependency(
        "MuJoCo",
        "mujoco",
        "mujoco",
        "physics of `simulate`, pictures of `report --film`",
        required=False,
        install="pip install 'climbplan[simulate]'",
    ),
    Dependency(
        "Drake",
        "drake",
        "pydrake",
        "`simulate --engine drake`",
        required=False,
        install="pip install 'climbplan[drake]'",
    ),
    Dependency(
        "rosbags",
        "rosbags",
        "rosbags",
        "`export --format mcap`, `ros2`",
        required=False,
        install="pip install 'climbplan[ros]'",
    ),
    Dependency(
        "OpenUSD",
        "usd-core",
        "pxr",
        "`export --format usd`",
        required=False,
        install="pip install 'climbplan[usd]'",
    ),
    Dependency(
        "imageio-ffmpeg",
        "imageio-ffmpeg",
        "imageio_ffmpeg",
        "`report --film FILE.mp4`",
        required=False,
        install="pip install 'climbplan[film]'",
    ),
    Dependency(
        "viser",
        "viser",
        "viser",
        "`view`",
        required=False,
        install="pip install 'climbplan[view]'",
    ),
    Dependency(
        "Chromium",
        "",
        "chromium chromium-browser google-chrome google-chrome-stable chrome",
        "test of report.html",
        required=False,
        install="from your system's packages",
    ),
)


@dataclass(frozen=True)
class DependencyState:
    """What is there of one part."""

    name: str
    version: str | None
    state: str  # "present", "missing", "missing, optional", "wrong version"
    purpose: str
    required: bool
    usable: bool
    advice: str  # what to do about it, "" if nothing

    def as_dict(self) -> dict[str, Any]:
        """Return plain values for JSON."""
        return dataclasses.asdict(self)


def examine() -> list[DependencyState]:
    """Look for every dependency."""
    return [_examine(dependency) for dependency in PARTS]


def _examine(dependency: Dependency) -> DependencyState:
    is_installed, number = _find(dependency)
    fault = dict(dependency.wrong_versions).get(number or "")
    if fault:
        state = "wrong version"
        advice = f"{fault}; pip install '{dependency.package}!={number}'"
    elif is_installed:
        state, advice = "present", ""
    else:
        state = "missing" if dependency.required else "missing, optional"
        how = dependency.install or (
            f"pip install {dependency.package}" if dependency.package else "reinstall CasADi"
        )
        advice = f"install with: {how}"
    usable = is_installed and not fault
    return DependencyState(
        dependency.name, number, state, dependency.purpose, dependency.required, usable, advice
    )


def _find(dependency: Dependency) -> tuple[bool, str | None]:
    """Return whether a dependency is installed, and its version if known without running it."""
    if "/" in dependency.module:
        module, stem = dependency.module.split("/")
        spec = find_spec(module)
        places = (spec.submodule_search_locations or []) if spec is not None else []
        return any(list(Path(place).glob(f"{stem}*")) for place in places), None
    if not dependency.package:
        return any(shutil.which(name) for name in dependency.module.split()), None
    try:
        number = version(dependency.package)
    except PackageNotFoundError:
        return find_spec(dependency.module) is not None, None
    return find_spec(dependency.module) is not None, number
