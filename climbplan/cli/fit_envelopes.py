"""`climbplan fit-envelopes`: McCormick envelopes learned from labelled terrains."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer

from climbplan.cli.console import Session, print_json, print_result
from climbplan.cli.options import Force, Json, Method, Out, Quiet, Seed, Set, Spec, Verbose

if TYPE_CHECKING:
    from climbplan.coupled.envelope_run import EnvelopeRun
    from climbplan.spec.overrides import Override

ENVELOPES_FILE = "envelopes.h5"


def fit_envelopes(
    context: typer.Context,
    spec: Spec,
    out: Out = None,
    assignments: Set = None,
    seed: Seed = None,
    method: Method = None,
    as_json: Json = False,
    quiet: Quiet = False,
    verbose: Verbose = False,
    force: Force = False,
) -> None:
    """Learn McCormick envelopes from random terrains, and validate them on held-out ones.

    Prints the path of the envelopes file. Its directory also holds report.json with the validation
    table: what the first stage calls feasible and infeasible, and what the second makes of it.
    """
    from climbplan.cli.output_directory import OutputDirectory
    from climbplan.cli.progress import StageProgress
    from climbplan.spec.envelopes_loading import load_envelopes
    from climbplan.spec.robot_source import load_robot

    session = context.ensure_object(Session)
    loaded = load_envelopes(spec, _overrides(assignments, seed, method))
    robot_spec = load_robot(loaded.spec.robot, loaded.directory)
    target = out if out is not None else Path("outputs", loaded.name)
    with OutputDirectory(target, force=force) as directory:
        from climbplan.coupled.envelope_file import write_envelopes
        from climbplan.coupled.envelope_run import fit_envelopes as fit
        from climbplan.robots.model import Robot

        with StageProgress(session) as progress:
            run = fit(loaded.spec, Robot.from_spec(robot_spec), progress.report)
        for line in _table(run):
            session.note(line)
        write_envelopes(run, loaded, directory.path / ENVELOPES_FILE)
        report = _report(run, loaded.name)
        text = json.dumps(report, indent=2) + "\n"
        (directory.path / "report.json").write_text(text, encoding="utf-8")
        directory.publish()
    if as_json:
        print_json(report)
    else:
        print_result(str(target / ENVELOPES_FILE))


def _overrides(
    assignments: list[str] | None, seed: int | None, method: str | None
) -> list[str | Override]:
    from climbplan.spec.overrides import Override

    given: list[str | Override] = list(assignments or ())
    for key, option, value in (("seed", "--seed", seed), ("fit.method", "--method", method)):
        if value is not None:
            given.append(Override(key, str(value), f"{option} {value}"))
    return given


def _table(run: EnvelopeRun) -> list[str]:
    rows = run.held_out
    feasible = int(rows.feasible.sum())
    counts = (
        f"{feasible} feasible and {len(rows.feasible) - feasible} infeasible held-out terrains "
        f"({rows.trivial} of {rows.drawn} drawn had no balance of forces, "
        f"{rows.undecided} stayed undecided)"
    )
    lines = [counts, "method      P1 feasible  P1 infeasible  P1 -> P2 convex  P1 -> P2 NLP"]
    for fitted in run.fitted:
        v = fitted.validation
        lines.append(
            f"{fitted.method:<11} {v.feasible:>10.1%} {v.infeasible:>14.1%} {v.convex:>16.1%} "
            f"{v.nlp:>13.1%}"
        )
    return lines


def _report(run: EnvelopeRun, name: str) -> dict[str, Any]:
    from dataclasses import asdict

    from climbplan.coupled.envelope_file import FORMAT, drawn

    return {
        "format": FORMAT,
        "name": name,
        "limb_names": list(run.limb_names),
        "training_fingerprint": run.fingerprint,
        "drawn": drawn(run),
        "validation": {f.method: asdict(f.validation) for f in run.fitted},
        "conditions": {f.method: asdict(f.conditions) for f in run.fitted},
        "timings": run.timings,
    }
