"""The commands that become one service, for clusters over several hosts."""

from __future__ import annotations

import os
import sys
from typing import Annotated, NoReturn

import typer

from services.command.outcome import checked, exit_

FORWARD = {"allow_extra_args": True, "ignore_unknown_options": True, "help_option_names": []}

app = typer.Typer()


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

    exit_(run(lambda stop: serve(stop, listen), "router"))


def _service(module: str, arguments: list[str]) -> NoReturn:
    """Become the service: signals and exit code are its own. `--config` may name a fleet that comes along."""
    from services.command.fleets import find

    config = next((at for at, word in enumerate(arguments[:-1], 1) if word == "--config"), None)
    if config is not None:
        name = arguments[config]
        arguments[config] = str(checked(lambda: find(name)))
    sys.stdout.flush()
    os.execv(sys.executable, [sys.executable, "-m", f"services.{module}", *arguments])
