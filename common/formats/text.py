"""Lines of a text file, gzipped or plain, with errors that name file and line."""

from __future__ import annotations

import gzip
import zlib
from collections.abc import Iterator
from pathlib import Path

from common.errors import BadFile


def numbered_lines(path: str | Path) -> Iterator[tuple[int, str]]:
    """(line number from 1, line) of every line that is neither empty nor a `#` comment.

    Whether the file is gzipped is seen from its first bytes, not from its name. Bytes that are no UTF-8 are
    replaced, so that a broken line breaks alone. Raises BadFile when the file cannot be read to its end.
    """
    path, number = Path(path), 0
    try:
        with path.open("rb") as file:
            zipped = file.read(2) == b"\x1f\x8b"
        with gzip.open(path, "rb") if zipped else path.open("rb") as stream:
            for raw in stream:
                number += 1
                line = raw.decode("utf-8", "replace").strip()
                if line and not line.startswith("#"):
                    yield number, line
    except (OSError, EOFError, zlib.error) as error:
        raise BadFile(f"{path}: cannot be read after line {number}: {error}; fetch the file again") from error
