"""Options that several commands share."""

from __future__ import annotations

from typing import Annotated

import typer

Endpoint = Annotated[
    str | None,
    typer.Option(help="Router; default: runs/latest/cluster.json, then $RECSLAM_ENDPOINT.", show_default=False),
]
AsJson = Annotated[bool, typer.Option("--json", help="For programs.")]
