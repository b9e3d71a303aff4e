"""Access to the URDFs that installed Python packages ship."""

from __future__ import annotations

from importlib.metadata import PackageNotFoundError, distribution
from pathlib import Path

from climbplan.errors import UsageError


def find_package_urdf(package: str, robot: str | None = None) -> Path:
    """Return the path of a URDF that an installed Python package ships.

    Args:
        package: Name of the package, such as `example-robot-data`, or `PACKAGE:ROBOT`.
        robot: Part of the URDF's path, such as `anymal_c`; None if `package` says it or if there is
            only one.

    Raises:
        UsageError: No URDF or several match; the message lists them.
    """
    package, _, query = package.partition(":")
    query = robot or query
    try:
        files = distribution(package).files or []
    except (PackageNotFoundError, ValueError) as error:
        raise UsageError(
            f"no Python package {package!r} is installed: `pip install {package}` if it is one of "
            "PyPI, or give its file by --urdf"
        ) from error
    urdfs = [Path(str(f.locate())) for f in files if f.name.endswith(".urdf")]
    urdfs = [path.resolve() for path in urdfs if path.is_file()]
    pattern = query.lower().removesuffix(".urdf")
    matches = [
        path for path in urdfs if any(pattern in name for name in _list_searched_names(path))
    ]
    exact = [path for path in matches if _is_exact_match(path, pattern)]
    if len(exact) == 1 or len(matches) == 1:
        return (exact or matches)[0]
    choices = ", ".join(sorted(map(_format_urdf_name, matches or urdfs)))
    if not urdfs:
        raise UsageError(f"the package {package!r} ships no URDF")
    expected = (
        f"--package {package}:PART" if not matches or not query else f"a longer part than {query!r}"
    )
    raise UsageError(f"expected {expected}, which names one URDF of: {choices}")


def _is_exact_match(path: Path, pattern: str) -> bool:
    """Return whether a part is a URDF's whole name, or its path from some folder on."""
    whole = path.with_suffix("").as_posix().lower()
    return pattern == _format_urdf_name(path).lower() or whole.endswith(f"/{pattern}")


def _format_urdf_name(path: Path) -> str:
    """Return the name of a URDF in a list: its mesh package and its own name."""
    return f"{path.parents[1].name}/{path.stem}"


def _list_searched_names(path: Path) -> tuple[str, str]:
    """Return the lower-case texts in which a part of a name is searched for."""
    return path.as_posix().lower(), _format_urdf_name(path).lower()
