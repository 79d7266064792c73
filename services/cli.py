"""The `recslam` command. Each command imports what it needs when it is called, so that help comes at once.

Exit codes: 0 done, 1 a fault of ours (or a service of the cluster died), 2 something that the operator can mend,
130 a batch run broken off by Ctrl-C.
"""

from __future__ import annotations

import asyncio
import io
import os
import sys
from collections.abc import Callable, Coroutine
from enum import StrEnum
from pathlib import Path
from typing import Annotated, Any, NoReturn, TypeVar

import typer

from common.errors import RecslamError, UsageError
from services.command.plan_commands import plan_commands

T = TypeVar("T")

app = typer.Typer(help="Several robots, one map.", no_args_is_help=True, add_completion=False, rich_markup_mode=None)
map_app = typer.Typer(help="The global map of a running cluster.", no_args_is_help=True)
app.add_typer(map_app, name="map")
app.add_typer(plan_commands(lambda work: _await(work), lambda work: _checked(work)), name="plan")

FORWARD = {"allow_extra_args": True, "ignore_unknown_options": True, "help_option_names": []}


class Topology(StrEnum):
    recslam = "recslam"
    cloud = "cloud"
    single_edge = "single-edge"
    edge_only = "edge-only"
    local = "local"


Out = Annotated[Path | None, typer.Option(help="Folder of the run (default: runs/<time>).", show_default=False)]
Endpoint = Annotated[
    str | None,
    typer.Option(help="Router; default: runs/latest/cluster.json, then $RECSLAM_ENDPOINT.", show_default=False),
]
TopologyOption = Annotated[Topology | None, typer.Option(help="Instead of the fleet file's.", show_default=False)]
Policy = Annotated[str | None, typer.Option(help="Scheduling policy instead of the fleet's.", show_default=False)]
Kernel = Annotated[str | None, typer.Option(help="SLAM kernel instead of the fleet's.", show_default=False)]
Keep = Annotated[bool, typer.Option("--keep", help="Leave the cluster up after the final map, until Ctrl-C.")]
AsJson = Annotated[bool, typer.Option("--json", help="For programs.")]
FleetName = Annotated[str, typer.Argument(metavar="FLEET", help="Fleet file, or the name of one that comes along.")]


@app.command()
def demo(out: Out = None, keep: Keep = False) -> None:
    """Map an apartment with four simulated robots and two edges, and score the map."""
    up("apartment", out, keep=keep)


@app.command()
def up(
    fleet: FleetName,
    out: Out = None,
    topology: TopologyOption = None,
    policy: Policy = None,
    kernel: Kernel = None,
    keep: Keep = False,
) -> None:
    """Start a whole cluster here: router, scheduler, cloud, edges and robots of a fleet file."""
    from services.command.cluster import run
    from services.command.fleets import load_fleet

    chosen = _overridden(_checked(lambda: load_fleet(fleet)), topology, policy, kernel)
    _exit(_await(run(chosen, out, _console(), keep=keep)))


@app.command()
def replay(
    log: Annotated[Path, typer.Argument(help="CARMEN log (also gzipped), or the folder of a recorded run.")],
    robots: Annotated[int, typer.Option(min=1, help="Robots among whom a log is cut.")] = 1,
    edges: Annotated[int | None, typer.Option(min=1, help="Edges (default: 1, or as recorded).")] = None,
    out: Out = None,
    topology: TopologyOption = None,
    policy: Policy = None,
    kernel: Kernel = None,
    keep: Keep = False,
) -> None:
    """Map a recorded log, or a recorded run of a fleet, as fast as the edges can."""
    from services.command import replay as recorded
    from services.command.cluster import run

    def make() -> tuple[Any, Any]:
        if log.is_dir():
            return recorded.from_recording(log, edges)
        return recorded.from_log(log, robots, edges or 1), None

    fleet, truth = _checked(make)
    _exit(_await(run(_overridden(fleet, topology, policy, kernel), out, _console(), truth=truth, keep=keep)))


@app.command()
def record(fleet: FleetName, out: Annotated[Path, typer.Option(help="Folder for the recording.")]) -> None:
    """Record what the robots of a fleet file see, to be replayed with every policy, kernel and topology."""
    from services.command.fleets import load_fleet
    from services.command.replay import record as record_fleet

    chosen = _checked(lambda: load_fleet(fleet))
    for robot, frames in _checked(lambda: record_fleet(chosen, out)).items():
        typer.echo(f"{robot}: {frames} frames")
    typer.echo(f"recorded in {out}; `recslam replay {out}` maps it")


@map_app.command("save")
def map_save(
    folder: Annotated[Path, typer.Argument(help="Folder for the files.")],
    name: Annotated[str, typer.Option(help="Name of the map's files.")] = "global_map",
    endpoint: Endpoint = None,
) -> None:
    """Save the global map as it is now: yaml + pgm for Nav2, png, transforms and trajectories."""
    from services.command.collect import global_map
    from services.command.finding import find
    from services.command.results import write_results

    async def save() -> None:
        async with await find(endpoint).open() as bus:
            result = await global_map(bus)
        write_results(result, folder, name)
        final = "final" if result.notice.final else "not final"
        typer.echo(f"map {result.notice.version} ({final}, {len(result.notice.components)} component(s)) in {folder}")

    _await(save())


@app.command()
def status(
    endpoint: Endpoint = None,
    as_json: Annotated[bool, typer.Option("--json", help="For programs.")] = False,
) -> None:
    """Show robots, edges, plan and map of a running cluster."""
    import json

    from services.command import status as view
    from services.command.finding import find

    async def show() -> None:
        async with await find(endpoint).open() as bus:
            found = await view.status(bus)
        if as_json:
            typer.echo(json.dumps(view.as_data(*found), indent=2))
        else:
            _console().print(view.as_tables(*found))

    _await(show())


@app.command()
def doctor(endpoint: Endpoint = None) -> None:
    """Find out why a cluster does not work. Exit code 1 when something is wrong with it."""
    from services.command.doctor import examine
    from services.command.finding import find

    async def check() -> bool:
        well = True
        async for finding in examine(find(endpoint)):
            typer.echo(f"{'ok  ' if finding.ok else 'BAD '} {finding.what}: {finding.text}")
            well &= finding.ok
        return well

    _exit(0 if _await(check()) else 1)


@app.command()
def why(
    a: Annotated[str, typer.Argument(help="A robot.")],
    b: Annotated[str, typer.Argument(help="Another one.")],
    picture: Annotated[Path | None, typer.Option(help="PNG of one map on the other, green where they agree.")] = None,
    endpoint: Endpoint = None,
    as_json: AsJson = False,
) -> None:
    """Tell why the maps of two robots of a running cluster are merged, or are not."""
    from services.command import why as view
    from services.command.finding import find

    async def explain() -> None:
        async with await find(endpoint).open() as bus:
            verdict, owner = await view.verdict_on(bus, a, b)
            world = await view.world(bus)
            shown = await view.draw(bus, verdict, world, picture) if picture is not None else ""
        said = [*view.as_lines(verdict, owner, world), *([f"picture    {picture}: {shown}"] if picture else [])]
        _tell(view.as_data(verdict, owner, world) if as_json else said)

    _await(explain())


@app.command()
def merge(
    maps: Annotated[list[Path], typer.Argument(help="yaml files of saved maps.")],
    out: Annotated[Path, typer.Option(help="Folder for the merged map.")],
    as_json: AsJson = False,
) -> None:
    """Merge saved maps of any origin and resolution; maps that share nothing are laid out apart."""
    from services.command import merge as merging

    merged = _checked(lambda: merging.merge(maps))
    files = _checked(lambda: merging.write(merged, out))
    _tell(merging.as_data(merged) if as_json else [*merging.as_lines(merged), f"written: {', '.join(map(str, files))}"])


@app.command()
def overlap(
    maps: Annotated[list[Path], typer.Argument(help="yaml files of saved maps.")], as_json: AsJson = False
) -> None:
    """How much saved maps share: |A and B| / (|A| + |B|) of each pair, 0 to 0.5."""
    from services.command import merge as merging

    merged = _checked(lambda: merging.merge(maps))
    _tell(merging.overlap_data(merged) if as_json else merging.overlap_lines(merged))


@app.command()
def warmup() -> None:
    """Compile all kernels, once after installation: the first run is slow otherwise."""
    from services.command.warmup import warmup as compile_all

    for name, seconds in compile_all():
        typer.echo(f"{name}: {seconds:.1f} s")


@app.command()
def profile(
    out: Annotated[Path, typer.Option(help="File to write; name it as scheduler.profile.")] = Path("profile.toml"),
    kernel: Kernel = None,
    seconds: Annotated[float, typer.Option(min=1, help="Length of the simulated drives.")] = 30.0,
) -> None:
    """Time SLAM and the fusion of 2 to 12 maps on this machine, for the scheduler to start from."""
    from common.config import SlamConfig
    from services.command.profile import profile as measure

    async def show() -> None:
        async for line in measure(kernel or SlamConfig().kernel, seconds, out):
            typer.echo(line)
        typer.echo(f"written to {out}")

    _await(show())


@app.command(context_settings=FORWARD)
def robot(context: typer.Context) -> None:
    """Run one robot's agent (arguments: recslam robot --help; --id replica: named after its compose replica)."""
    from services.command.replica import replica_name

    _service("robot_agent", [replica_name() if word == "replica" else word for word in context.args])


@app.command(context_settings=FORWARD)
def edge(context: typer.Context) -> None:
    """Run one edge worker (arguments: recslam edge --help)."""
    _service("edge_worker", context.args)


@app.command(context_settings=FORWARD)
def cloud(context: typer.Context) -> None:
    """Run the cloud merger (arguments: recslam cloud --help)."""
    _service("cloud_merger", context.args)


@app.command(context_settings=FORWARD)
def scheduler(context: typer.Context) -> None:
    """Run the scheduler (arguments: recslam scheduler --help)."""
    _service("scheduler", context.args)


@app.command()
def router(
    listen: Annotated[str, typer.Option(help="Address to listen on.")] = "tcp/127.0.0.1:7447",
) -> None:
    """Run a router for services on several hosts or in several containers."""
    from common.service import run
    from services.command.router import serve

    _exit(run(lambda stop: serve(stop, listen), "router"))


def main() -> None:
    if isinstance(sys.stdout, io.TextIOWrapper):
        sys.stdout.reconfigure(line_buffering=True)  # who reads it through a pipe reads it in time
    app(prog_name="recslam")


def _service(module: str, arguments: list[str]) -> NoReturn:
    """Become the service: signals and exit code are its own. `--config` may name a fleet that comes along."""
    from services.command.fleets import find

    config = next((at for at, word in enumerate(arguments[:-1], 1) if word == "--config"), None)
    if config is not None:
        name = arguments[config]
        arguments[config] = str(_checked(lambda: find(name)))
    sys.stdout.flush()
    os.execv(sys.executable, [sys.executable, "-m", f"services.{module}", *arguments])


def _tell(said: Any) -> None:
    import json

    if isinstance(said, list):
        typer.echo("\n".join(said))
    else:
        typer.echo(json.dumps(said, indent=2))


def _overridden(fleet: Any, topology: Topology | None, policy: str | None, kernel: str | None) -> Any:
    from services.command.fleets import revised

    sections: dict[str, Any] = {
        "topology": topology.value if topology else None,
        "scheduler": {"policy": policy} if policy else None,
        "slam": {"kernel": kernel} if kernel else None,
    }
    return _checked(lambda: revised(fleet, **{name: value for name, value in sections.items() if value is not None}))


def _console() -> Any:
    from rich.console import Console

    return Console() if sys.stdout.isatty() else Console(width=160)


def _await(work: Coroutine[Any, Any, T]) -> T:
    return _checked(lambda: asyncio.run(work))


def _checked(work: Callable[[], T]) -> T:
    """The result of `work()`; our own errors become one line and an exit code."""
    import logging

    logging.basicConfig(level=logging.WARNING, format="%(levelname)s %(message)s")
    try:
        return work()
    except UsageError as error:
        print(f"recslam: {error}", file=sys.stderr)
        _exit(2)
    except RecslamError as error:
        print(f"recslam: {error}", file=sys.stderr)
        _exit(1)
    except KeyboardInterrupt:
        _exit(130)


def _exit(code: int) -> NoReturn:
    raise typer.Exit(code)
