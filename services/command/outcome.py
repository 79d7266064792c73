"""How a command ends: our own errors become one line and an exit code."""

from __future__ import annotations

import asyncio
import logging
import sys
from collections.abc import Callable, Coroutine
from typing import Any, NoReturn, TypeVar

import typer

from common.errors import RecslamError, UsageError

T = TypeVar("T")


def await_(work: Coroutine[Any, Any, T]) -> T:
    return checked(lambda: asyncio.run(work))


def checked(work: Callable[[], T]) -> T:
    """The result of `work()`; our own errors, and files that cannot be written, become one line and an exit code."""
    logging.basicConfig(level=logging.WARNING, format="%(levelname)s %(message)s")
    try:
        return work()
    except UsageError as error:
        print(f"recslam: {error}", file=sys.stderr)
        exit_(2)
    except RecslamError as error:
        print(f"recslam: {error}", file=sys.stderr)
        exit_(1)
    except OSError as error:
        if error.filename is None:
            raise
        print(f"recslam: {error.filename}: {error.strerror}", file=sys.stderr)
        exit_(2)
    except KeyboardInterrupt:
        exit_(130)


def exit_(code: int) -> NoReturn:
    raise typer.Exit(code)
