"""The command line of `recslam plan`; what it does is in plan.py."""

from __future__ import annotations

import json
from collections.abc import Iterable
from pathlib import Path
from typing import Annotated, Any

import typer

from services.command.options import AsJson, Endpoint
from services.command.outcome import await_, checked

app = typer.Typer(
    help="Group robots offline, explain the plan of a running cluster, or ask it what it would do.",
    invoke_without_command=True,
)


@app.callback()
def plan(
    context: typer.Context,
    matrix: Annotated[Path | None, typer.Option(help="Overlap matrix: npz (array 'weights') or csv.")] = None,
    routes: Annotated[Path | None, typer.Option(help="Planned routes or start poses: TOML or JSON.")] = None,
    what_if: Annotated[
        str | None, typer.Option("--what-if", help="Ask the running cluster: edge-2=down, or edge-1=0.5 (speed).")
    ] = None,
    edges: Annotated[int, typer.Option(help="Groups to make out of a file.")] = 2,
    policy: Annotated[str, typer.Option(help="Scheduling policy for a file.")] = "recslam",
    budget_ms: Annotated[float, typer.Option(help="Time that the search may take.")] = 500.0,
    endpoint: Endpoint = None,
    as_json: AsJson = False,
) -> None:
    if context.invoked_subcommand is not None:
        return
    from services.command import plan as planning

    if what_if is not None:
        await_(_ask(endpoint, what_if, as_json))
        return
    found = checked(lambda: planning.offline(matrix, routes, edges, policy, budget_ms))
    _echo(found, planning.offline_lines(found), as_json)


@app.command()
def why(endpoint: Endpoint = None, as_json: AsJson = False) -> None:
    """Explain the plan of a running cluster."""
    await_(_ask(endpoint, None, as_json))


async def _ask(endpoint: str | None, supposed: str | None, as_json: bool) -> None:
    from services.command import plan as planning
    from services.command.finding import find

    async with await find(endpoint).open() as bus:
        plan, overlap = await planning.why(bus) if supposed is None else (await planning.what_if(bus, supposed), None)
    _echo(planning.as_data(plan, overlap), planning.lines(plan, overlap), as_json)


def _echo(data: Any, lines: Iterable[str], as_json: bool) -> None:
    if as_json:
        typer.echo(json.dumps(data, indent=2))
    else:
        for line in lines:
            typer.echo(line)
