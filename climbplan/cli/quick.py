"""`--quick` and `--no-report` of the planning commands: what each leaves out, spelt once."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated, Literal

import typer

if TYPE_CHECKING:
    from climbplan.schema.overrides import Override

# By kind of spec: key, value, and what a spec of the user's may say without being changed
_QUICK: dict[str, tuple[tuple[str, str, Literal["least", "most"] | None], ...]] = {
    "climb": (
        ("solver.gap", "0.01", "least"),
        ("solver.starts", "2", "most"),
        ("study", "null", None),
    ),
    "transition": (("solver.starts", "2", "most"),),
    "mpc": (
        ("solver.max_qp_solves", "150", "most"),
        ("solver.gap", "0.3", "least"),
        ("library.size", "6", "most"),
    ),
    "bookshelf": (("solver.gap", "0.05", "least"),),
    "limms": (),
}
_WORDS = {"least": "at least ", "most": "at most ", None: ""}


def quick_overrides(kind: str, quick: bool) -> list[str | Override]:
    """Return the overrides of `--quick` for a kind; `--set` and other options take precedence."""
    from climbplan.schema.overrides import Override

    return [Override(key, value, "--quick", bound) for key, value, bound in _QUICK[kind] if quick]


def _help(kind: str) -> str:
    sets = [f"{_WORDS[bound]}{key}={value}" for key, value, bound in _QUICK[kind]]
    first = f"sets {', '.join(sets)} (--set takes precedence)" if sets else "changes no key"
    return f"Fast planning for a first look: {first}; no report, as with --no-report."


NoReport = Annotated[
    bool,
    typer.Option(
        "--no-report", help="No page and no figures; report.json is written all the same."
    ),
]
QuickClimb = Annotated[bool, typer.Option("--quick", help=_help("climb"))]
QuickTransition = Annotated[bool, typer.Option("--quick", help=_help("transition"))]
QuickWalk = Annotated[bool, typer.Option("--quick", help=_help("mpc"))]
QuickShelf = Annotated[bool, typer.Option("--quick", help=_help("bookshelf"))]
QuickModules = Annotated[bool, typer.Option("--quick", help=_help("limms"))]
