"""`climbplan fit-envelopes`: McCormick envelopes learned from labelled terrains."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from climbplan.cli.console import Invocation, print_json, print_result
from climbplan.cli.options import Force, Json, Out, Quiet, Seed, Set, Spec, Verbose

if TYPE_CHECKING:
    from climbplan.climb.envelopes.run import EnvelopeRun

ENVELOPES_FILE = "envelopes.h5"
_CONDITIONS = "   (1) meets  (2) excludes  (3) projects"

EnvelopeMethod = Annotated[
    str | None,
    typer.Option(
        "--method",
        metavar="NAME",
        help="Method: all, clustering, genetic or heuristic; sets `fit.method`.",
    ),
]


def fit_envelopes(
    context: typer.Context,
    spec: Spec,
    *,
    out: Out = None,
    assignments: Set = None,
    seed: Seed = None,
    method: EnvelopeMethod = None,
    jobs: Annotated[
        int,
        typer.Option(
            "--jobs",
            "-j",
            metavar="N",
            min=1,
            help="Number of worker processes of the genetic search.",
        ),
    ] = 1,
    as_json: Json = False,
    quiet: Quiet = False,
    verbose: Verbose = False,
    force: Force = False,
) -> None:
    """Learn McCormick envelopes from random terrains, and validate them on held-out ones.

    Prints the path of the envelopes file. Its directory also holds report.json, report.html and
    figures with the validation table: what the first stage calls feasible and infeasible, what the
    second makes of it, and how far the theorem's conditions hold. Terrains are drawn, or those of a
    dataset (data.dataset). The result does not depend on --jobs.
    """
    from climbplan.cli.output_directory import OutputDirectory
    from climbplan.cli.progress import StageProgress
    from climbplan.cli.spec_options import key_overrides
    from climbplan.climb.schema.envelopes_loading import load_envelopes
    from climbplan.schema.robots.source import load_any_robot

    session = context.ensure_object(Invocation)
    overrides = key_overrides(
        assignments, ("seed", "--seed", seed), ("fit.method", "--method", method)
    )
    loaded = load_envelopes(spec, overrides)
    robot_spec = load_any_robot(loaded.spec.robot, loaded.directory)
    target = out if out is not None else Path("outputs", loaded.name)
    with OutputDirectory(target, force=force) as directory:
        from climbplan.climb.envelopes.file import write_envelopes
        from climbplan.climb.envelopes.run import fit_envelopes as fit
        from climbplan.climb.pages.envelope_report import write_report
        from climbplan.robots.any_robot import build_robot, require_no_flat_feet

        with StageProgress(session) as progress:
            pointed = require_no_flat_feet(robot_spec, "envelopes")
            run = fit(loaded, build_robot(pointed), progress.report, jobs)
        for line in _table(run):
            session.note(line)
        write_envelopes(run, loaded, directory.path / ENVELOPES_FILE)
        report = write_report(run, loaded, directory.path)
        directory.publish()
    if as_json:
        print_json({**report, "file": str(target / ENVELOPES_FILE)})
    else:
        print_result(str(target / ENVELOPES_FILE))


def _table(run: EnvelopeRun) -> list[str]:
    rows = run.held_out
    feasible = int(rows.feasible.sum())
    counts = (
        f"{feasible} feasible and {len(rows.feasible) - feasible} infeasible held-out terrains "
        f"({rows.trivial} of {rows.drawn} drawn had no balance of forces, "
        f"{rows.undecided} stayed undecided)"
    )
    lines = [
        counts,
        f"method      P1 feasible  P1 infeasible  P1 -> P2 convex  P1 -> P2 NLP{_CONDITIONS}",
    ]
    for fitted in run.fitted:
        v, c = fitted.validation, fitted.conditions
        lines.append(
            f"{fitted.method:<11} {v.feasible:>11.1%} {v.infeasible:>14.1%} {v.convex:>16.1%} "
            f"{v.nlp:>13.1%} {c.meets:>11.1%} {c.excludes:>13.1%} {c.projects:>13.1%}"
        )
    return lines
