"""`climbplan bench`: comparison tables, each figure as a ratio measured in the same run."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer

from climbplan.cli.bench_scenes import bench_scenes, comparison
from climbplan.cli.bench_walks import bench_walks
from climbplan.cli.console import Session, print_result, standard_output
from climbplan.cli.options import Force, Quiet, Verbose
from climbplan.errors import UsageError

BENCHMARKS = {
    "posture": "posture planner against SCIP on the same statement",
    "force": "force planner against CVXPY and Clarabel on the same instants",
    "plan": "the whole decoupled plan: postures, joint angles, forces, checks",
    "coupled": "positions and forces together: against CVXPY, and on random slippery bands",
    "transition": "complementarity from random starts against the search over stance sets",
    "mpc": "walking: offline methods, accuracy of envelopes, ticks online, recovery from pushes",
    "refusals": "random climbs: planned, proved impossible or not proved, limits, second tries",
    "stands": "shipped and random climbs in MuJoCo, with margins and without",
    "scans": "meshes of hpp-environments: regions, rounds, verified, standing on the raw mesh",
    "judge": "the quasi-static engine against MuJoCo in the same worlds of shipped scenes",
    "zoo": "robots of example-robot-data from URDF to verified plans, and in MuJoCo",
    "growth": "cost over rounds 2 to 32 and limbs 4 to 8",
    "windows": "1,000 regions in windows of rounds, and a rocky tube climbed to its end",
    "bookshelf": "all methods on the same bookshelf scenes, and published placements",
    "strategies": "trained strategies beside each other and beside exact, by data size",
    "limms": "search and consensus on the same scenes of modules, random ones, and random rooms",
    "instances": "SCIP, HiGHS, Bonmin and the own tree on the public set of contact problems",
    "engine": "the own trees, cold and remembering, beside DAQP, HiGHS, SCIP; walls, products",
}
_QUICK: dict[str, dict[str, Any]] = {  # of comparisons of methods on the same scenes
    "bookshelf": {"count": 8, "some": 3, "few": 1, "seconds": 2.0, "library_size": 100},
    "strategies": {
        "count": 12,
        "some": 2,
        "few": 6,
        "clusters": 1,
        "seconds": 10.0,
        "library_size": 100,
        "methods": "random,knn,forest,network",
    },
    "limms": {"count": 1, "seconds": 60.0, "scenes": ("limms_throw",)},
}
# Options that benchmarks know which do not know all of them
_KNOWN = {
    "limms": ("methods", "count", "seconds"),
    "refusals": ("count", "seconds"),
    "stands": ("count",),
    "judge": ("count",),
    "scans": ("scenes",),
    "zoo": ("scenes", "methods", "count", "jobs"),
    "instances": ("methods", "count", "seconds"),
    "mpc": ("methods", "count", "library", "library_size", "jobs", "assignments"),
}
_PANEL = "bench bookshelf, strategies, limms, mpc, refusals, stands, judge, scans, instances"


def bench(
    context: typer.Context,
    name: Annotated[
        str | None, typer.Argument(metavar="NAME", help="One benchmark [default: all].")
    ] = None,
    show_list: Annotated[bool, typer.Option("--list", help="List the benchmarks.")] = False,
    quick: Annotated[bool, typer.Option("--quick", help="Smaller instances, fewer runs.")] = False,
    seed: Annotated[int, typer.Option("--seed", metavar="N", min=0, help="Seed.")] = 0,
    scenes: Annotated[
        str | None,
        typer.Option(
            "--scenes",
            metavar="FILE[:GROUP]",
            help="Scenes to solve [default: generated, with pymunk]; of scans: folder of "
            "meshes [.]; of zoo: robots, by commas.",
            rich_help_panel=_PANEL,
        ),
    ] = None,
    library: Annotated[
        Path | None,
        typer.Option(
            "--library",
            metavar="PLAN",
            help="Solved scenes for methods that learn, solved walks for mpc [default: generated].",
            rich_help_panel=_PANEL,
        ),
    ] = None,
    published: Annotated[
        str | None,
        typer.Option(
            "--published",
            metavar="FILE[:GROUP]",
            help="Published placements (theta, X) to check and compare.",
            rich_help_panel=_PANEL,
        ),
    ] = None,
    methods: Annotated[
        str | None,
        typer.Option(
            "--methods",
            metavar="NAMES",
            help="Methods, by commas; of limms rooms, turned too; mpc tables, instances solvers.",
            rich_help_panel=_PANEL,
        ),
    ] = None,
    count: Annotated[
        int | None,
        typer.Option(
            "--count",
            metavar="N",
            min=0,
            help="Scenes [40]; 0: only --published. Of modules: random throws, jumps, rooms [30]. "
            "Of mpc: walks under each push [20]. Of refusals: climbs [60]. Of judge: worlds of "
            "each scene [16]. Of instances: of each family and class [9].",
            rich_help_panel=_PANEL,
        ),
    ] = None,
    some: Annotated[
        int | None,
        typer.Option(
            "--some",
            metavar="N",
            min=1,
            help="Scenes of methods that take about a second [20].",
            rich_help_panel=_PANEL,
        ),
    ] = None,
    few: Annotated[
        int | None,
        typer.Option(
            "--few",
            metavar="N",
            min=1,
            help="Scenes of the slowest methods [4].",
            rich_help_panel=_PANEL,
        ),
    ] = None,
    time_limit: Annotated[
        float | None,
        typer.Option(
            "--time-limit",
            metavar="SECONDS",
            min=0.1,
            help="Of one scene of the slowest methods [5]; of one plan of modules [300]; of one "
            "random climb [20], ten times that for second tries; of one of the instances [10].",
            rich_help_panel=_PANEL,
        ),
    ] = None,
    clusters: Annotated[
        int | None,
        typer.Option(
            "--clusters",
            metavar="N",
            min=0,
            help="Clusters whose reduced programs HiGHS and SCIP solve, bench strategies [6].",
            rich_help_panel=_PANEL,
        ),
    ] = None,
    library_size: Annotated[
        int | None,
        typer.Option(
            "--library-size",
            metavar="N",
            min=1,
            help="Generated scenes in the library [1000]; walks for mpc.",
            rich_help_panel=_PANEL,
        ),
    ] = None,
    assignments: Annotated[
        list[str] | None,
        typer.Option(
            "--set",
            "-s",
            metavar="KEY=VALUE",
            help="Of mpc: set a key of mpc_recovery.yaml, whose loop is walked. Repeatable.",
            rich_help_panel=_PANEL,
        ),
    ] = None,
    jobs: Annotated[
        int | None,
        typer.Option(
            "--jobs",
            "-j",
            metavar="N",
            min=1,
            help="Of mpc and zoo: parallel workers; what is counted does not depend on them.",
            rich_help_panel=_PANEL,
        ),
    ] = None,
    out: Annotated[
        Path | None,
        typer.Option(
            "--out",
            "-o",
            metavar="DIR",
            help="Also write tables, JSON and plots there; of instances and zoo: results, which a "
            "later run goes on with.",
            rich_help_panel=_PANEL,
        ),
    ] = None,
    as_json: Annotated[
        bool,
        typer.Option("--json", help="Print one JSON object instead.", rich_help_panel=_PANEL),
    ] = False,
    force: Force = False,
    quiet: Quiet = False,
    verbose: Verbose = False,
) -> None:
    """Compare the planners with named alternatives on the same instances.

    Options from --scenes to --json are those of `bench bookshelf` and, but for --published,
    `bench strategies`; `bench limms` knows --methods, --count and --time-limit of them, `bench mpc`
    --methods (offline, envelopes, bounds, stones, ticks, strategies, recovery, pushes), --count,
    --library and --library-size, `bench refusals` --count and --time-limit, `bench stands` and
    `bench judge` --count, `bench scans` --scenes, the folder of its meshes, `bench zoo` --scenes,
    its robots, --methods (plans, refusals: looked at again by a second method), --count,
    --jobs and --out.
    """
    if show_list:
        for known, meaning in BENCHMARKS.items():
            print_result(f"{known:<11}{meaning}")
        return
    if name is not None and name not in BENCHMARKS:
        raise UsageError(f"no benchmark {name!r}, known are {', '.join(BENCHMARKS)}")
    given: dict[str, Any] = {
        "scenes": scenes,
        "library": library,
        "published": published,
        "methods": methods,
        "count": count,
        "some": some,
        "few": few,
        "seconds": time_limit,
        "library_size": library_size,
        "clusters": clusters,
        "assignments": assignments,
        "jobs": jobs,
    }
    given = {key: value for key, value in given.items() if value is not None}
    if name not in _QUICK and name not in _KNOWN and (given or out is not None or as_json):
        raise UsageError(
            "options from --scenes to --json go with `bench bookshelf`, `bench strategies` and, "
            "some of them, `bench limms`, `bench mpc`, `bench refusals` and `bench instances`"
        )
    if name in ("refusals", "stands", "judge", "scans") and (out is not None or as_json):
        raise UsageError(f"`bench {name}` has no --out and no --json")
    allowed = _KNOWN.get(name or "", tuple(set(given) - {"jobs", "assignments"}))
    if stray := sorted(set(given) - set(allowed)):
        raise UsageError(f"`bench {name}` has no {_option(stray[0])}")
    if name == "strategies" and published is not None:
        raise UsageError("--published goes with `bench bookshelf`")
    if name == "bookshelf" and clusters is not None:
        raise UsageError("--clusters goes with `bench strategies`")
    if name in ("instances", "zoo") and as_json:
        raise UsageError(f"`bench {name}` has no --json: results.csv of --out has all numbers")
    session = context.ensure_object(Session)
    for chosen in [name] if name is not None else BENCHMARKS:
        session.note(f"bench {chosen}: {BENCHMARKS[chosen]}")
        if chosen in _QUICK:
            wanted = {**(_QUICK[chosen] if quick else {}), **given, "seed": seed}
            bench_scenes(session, comparison(chosen, wanted), out, force, as_json)
            continue
        if chosen == "mpc":
            bench_walks(session, {**given, "seed": seed, "quick": quick}, out, force, as_json)
            continue
        if chosen == "refusals":
            from climbplan.bench.climb.refusals import bench_refusals

            own = {key: given[key] for key in _KNOWN["refusals"] if key in given}
            with standard_output() as stream:
                bench_refusals(seed, quick, stream, **own)
            continue
        if chosen == "engine":
            from climbplan.bench.engine.run import run_engine

            with standard_output() as stream:
                run_engine(seed, quick, stream)
            continue
        if chosen == "instances":
            from climbplan.bench.instances.run import bench_instances

            with standard_output() as stream:
                bench_instances(
                    seed,
                    quick,
                    stream,
                    out,
                    given.get("count"),
                    given.get("seconds"),
                    methods,
                )
            continue
        if chosen == "stands":
            from climbplan.bench.climb.stands import bench_stands

            with standard_output() as stream:
                bench_stands(seed, quick, stream, given.get("count"))
            continue
        if chosen == "judge":
            from climbplan.bench.climb.judge import bench_judge

            with standard_output() as stream:
                bench_judge(seed, quick, stream, given.get("count"))
            continue
        if chosen == "scans":
            from climbplan.bench.climb.scans import bench_scans

            with standard_output() as stream:
                bench_scans(quick, stream, scenes)
            continue
        if chosen == "zoo":
            from climbplan.bench.zoo.run import bench_zoo

            with standard_output() as stream:
                bench_zoo(quick, stream, scenes, out, methods, seed, given.get("count"), jobs or 1)
            continue
        if chosen == "transition":
            from climbplan.bench.transition import run_transition

            with standard_output() as stream:
                run_transition(seed, quick, stream)
            continue
        from climbplan.bench.climb.run import run

        with standard_output() as stream:
            run(chosen, seed, quick, stream)


def _option(key: str) -> str:
    """The option that gives a key."""
    others = {"seconds": "time-limit", "assignments": "set"}
    return f"--{others.get(key, key).replace('_', '-')}"
