"""The `recslam` command. Each command imports what it needs when it is called, so that help comes at once.

Exit codes: 0 done, 1 a fault of ours (or a service of the cluster died), 2 something that the operator can mend,
130 a batch run broken off by Ctrl-C.
"""

from __future__ import annotations

import io
import sys
from enum import StrEnum
from pathlib import Path
from typing import Annotated, Any

import typer

from services.command import map_commands, plan_commands, service_commands
from services.command.options import AsJson, Endpoint
from services.command.outcome import await_, checked, exit_

app = typer.Typer(help="Several robots, one map.", no_args_is_help=True, add_completion=False, rich_markup_mode=None)
app.add_typer(map_commands.app)
app.add_typer(plan_commands.app, name="plan")
app.add_typer(service_commands.app)


class Topology(StrEnum):
    recslam = "recslam"
    cloud = "cloud"
    single_edge = "single-edge"
    edge_only = "edge-only"
    local = "local"


Out = Annotated[Path | None, typer.Option(help="Folder of the run (default: runs/<time>).", show_default=False)]
TopologyOption = Annotated[Topology | None, typer.Option(help="Instead of the fleet file's.", show_default=False)]
Policy = Annotated[str | None, typer.Option(help="Scheduling policy instead of the fleet's.", show_default=False)]
Kernel = Annotated[str | None, typer.Option(help="SLAM kernel instead of the fleet's.", show_default=False)]
Keep = Annotated[bool, typer.Option("--keep", help="Leave the cluster up after the final map, until Ctrl-C.")]
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

    chosen = _overridden(checked(lambda: load_fleet(fleet)), topology, policy, kernel)
    exit_(await_(run(chosen, out, _console(), keep=keep)))


@app.command()
def replay(
    log: Annotated[Path, typer.Argument(help="CARMEN log (also gzipped), or the folder of a recorded run.")],
    robots: Annotated[
        int | None, typer.Option(min=1, help="Robots among whom a log is cut (default: 1).", show_default=False)
    ] = None,
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
            return recorded.from_recording(log, robots, edges)
        return recorded.from_log(log, robots or 1, edges or 1), None

    fleet, truth = checked(make)
    exit_(await_(run(_overridden(fleet, topology, policy, kernel), out, _console(), truth=truth, keep=keep)))


@app.command()
def record(fleet: FleetName, out: Annotated[Path, typer.Option(help="Folder for the recording.")]) -> None:
    """Record what the robots of a fleet file see, to be replayed with every policy, kernel and topology."""
    from services.command.fleets import load_fleet
    from services.command.replay import record as record_fleet

    chosen = checked(lambda: load_fleet(fleet))
    for robot, frames in checked(lambda: record_fleet(chosen, out)).items():
        typer.echo(f"{robot}: {frames} frames")
    typer.echo(f"recorded in {out}; `recslam replay {out}` maps it")


@app.command()
def status(
    endpoint: Endpoint = None,
    as_json: AsJson = False,
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

    await_(show())


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

    exit_(0 if await_(check()) else 1)


@app.command()
def warmup() -> None:
    """Compile all kernels, once after installation: the first run is slow otherwise."""
    from services.command.warmup import warmup as compile_all

    for name, seconds in compile_all():
        typer.echo(f"{name}: {seconds:.1f} s")


@app.command()
def profile(
    out: Annotated[Path, typer.Option(help="File to write; name it as scheduler.profile.")] = Path("profile.toml"),
    kernel: Annotated[str | None, typer.Option(help="SLAM kernel (default: graph).", show_default=False)] = None,
    seconds: Annotated[float, typer.Option(min=1, help="Length of the simulated drives.")] = 30.0,
) -> None:
    """Time SLAM and the fusion of 2 to 12 maps on this machine, for the scheduler to start from."""
    from common.config import SlamConfig
    from services.command.profile import profile as measure

    async def show() -> None:
        async for line in measure(kernel or SlamConfig().kernel, seconds, out):
            typer.echo(line)
        typer.echo(f"written to {out}")

    await_(show())


def main() -> None:
    if isinstance(sys.stdout, io.TextIOWrapper):
        sys.stdout.reconfigure(line_buffering=True)  # who reads it through a pipe reads it in time
    app(prog_name="recslam")


def _overridden(fleet: Any, topology: Topology | None, policy: str | None, kernel: str | None) -> Any:
    from services.command.fleets import revised

    sections: dict[str, Any] = {
        "topology": topology.value if topology else None,
        "scheduler": {"policy": policy} if policy else None,
        "slam": {"kernel": kernel} if kernel else None,
    }
    return checked(lambda: revised(fleet, **{name: value for name, value in sections.items() if value is not None}))


def _console() -> Any:
    from rich.console import Console

    return Console() if sys.stdout.isatty() else Console(width=160)
