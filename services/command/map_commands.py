"""The commands about maps: of a running cluster, and saved ones."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated, Any

import typer

from services.command.options import AsJson, Endpoint
from services.command.outcome import await_, checked

app = typer.Typer()
saving = typer.Typer(help="The global map of a running cluster.", no_args_is_help=True)
app.add_typer(saving, name="map")


@saving.command("save")
def map_save(
    folder: Annotated[Path, typer.Argument(help="Folder for the files.")],
    name: Annotated[str, typer.Option(help="Name of the map's files.")] = "global_map",
    endpoint: Endpoint = None,
) -> None:
    """Save the global map as it is now: yaml + pgm for Nav2, png, transforms and trajectories."""
    from common.grid.versions import count_of
    from services.command.collect import global_map
    from services.command.finding import find
    from services.command.results import write_results

    async def save() -> None:
        async with await find(endpoint).open() as bus:
            result = await global_map(bus)
        write_results(result, folder, name)
        final = "final" if result.notice.final else "not final"
        typer.echo(
            f"map {count_of(result.notice.version)} ({final}, {len(result.notice.components)} component(s)) in {folder}"
        )

    await_(save())


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

    await_(explain())


@app.command()
def merge(
    maps: Annotated[list[Path], typer.Argument(help="yaml files of saved maps.")],
    out: Annotated[Path, typer.Option(help="Folder for the merged map.")],
    as_json: AsJson = False,
) -> None:
    """Merge saved maps of any origin and resolution; maps that share nothing are laid out apart."""
    from services.command import merge as merging

    merged = checked(lambda: merging.merge(maps))
    files = checked(lambda: merging.write(merged, out))
    _tell(merging.as_data(merged) if as_json else [*merging.as_lines(merged), f"written: {', '.join(map(str, files))}"])


@app.command()
def overlap(
    maps: Annotated[list[Path], typer.Argument(help="yaml files of saved maps.")], as_json: AsJson = False
) -> None:
    """How much saved maps share: |A and B| / (|A| + |B|) of each pair, 0 to 0.5."""
    from services.command import merge as merging

    merged = checked(lambda: merging.merge(maps))
    _tell(merging.overlap_data(merged) if as_json else merging.overlap_lines(merged))


def _tell(said: Any) -> None:
    if isinstance(said, list):
        typer.echo("\n".join(said))
    else:
        typer.echo(json.dumps(said, indent=2))
