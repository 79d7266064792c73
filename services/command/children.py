"""The services of a cluster as child processes: started, watched, stopped; none outlives this process."""

from __future__ import annotations

import asyncio
import logging
import os
import signal
from asyncio.subprocess import DEVNULL, STDOUT, Process
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from types import TracebackType

from common.config import ENV_ELSEWHERE, ENV_PREFIX
from common.errors import ServiceDied
from common.parent import Leash
from services.command.run_folder import RunFolder
from services.command.topology import Program

GRACE_S = 15.0
"""from the polite signal to the hard one"""
TAIL_LINES = 15

log = logging.getLogger(__name__)


class Children:
    """`async with Children(folder, endpoint) as children`; leaving it stops them all, politely first.

    Each is in a process group of its own (or in that of the program it runs beside), so that Ctrl-C on the terminal
    reaches this process alone and a hard stop takes worker processes along.
    """

    def __init__(self, folder: RunFolder, endpoint: str) -> None:
        self.folder, self._endpoint = folder, endpoint
        self._leash = Leash()
        self._processes: dict[str, Process] = {}
        self._spared: set[str] = set()
        """programs that were killed, and without which the others go on"""

    async def start(self, program: Program) -> None:
        await asyncio.sleep(program.delay_s)
        group = self._processes[program.beside].pid if program.beside else 0
        with self.folder.log(program.name).open("ab") as output:
            self._processes[program.name] = await asyncio.create_subprocess_exec(
                *program.command(self.folder.config, self._endpoint),
                stdin=DEVNULL,
                stdout=output,
                stderr=STDOUT,
                env=_environment() | self._leash.environment,
                pass_fds=self._leash.pass_fds,
                process_group=group,
            )

    def pid(self, name: str) -> int:
        """Process id of the program of this name."""
        return self._processes[name].pid

    async def watch(self, spare: Callable[[str, str], bool] = lambda name, how: False) -> None:
        """Return never: raises ServiceDied as soon as a child has ended, also one that is started later.

        Of one that was killed or stopped from outside, `spare(name, how)` says whether the others go on without it.
        """
        while True:
            for name, process in self._processes.items():
                code = process.returncode
                if code is None or name in self._spared:
                    continue
                if code > 0 or not spare(name, _how(code)):
                    raise ServiceDied(_obituary(name, code, self.folder.log(name)))
                self._spared.add(name)
            await asyncio.sleep(0.1)

    async def stop(self) -> None:
        """Ask all to stop, and end those hard that have not within the grace time."""
        living = [process for process in self._processes.values() if process.returncode is None]
        for process in living:
            with suppress(ProcessLookupError):
                process.terminate()
        waits = [asyncio.ensure_future(process.wait()) for process in living]
        if waits:
            _, late = await asyncio.wait(waits, timeout=GRACE_S)
            for process in [process for process, wait in zip(living, waits, strict=True) if wait in late]:
                log.warning("a service did not stop when asked: killed", extra={"pid": process.pid})
                with suppress(ProcessLookupError, PermissionError):
                    os.killpg(os.getpgid(process.pid), signal.SIGKILL)
            await asyncio.gather(*waits)
        self._leash.close()

    async def __aenter__(self) -> Children:
        return self

    async def __aexit__(
        self, kind: type[BaseException] | None, error: BaseException | None, tb: TracebackType | None
    ) -> None:
        await asyncio.shield(asyncio.ensure_future(self.stop()))


def _environment() -> dict[str, str]:
    """Ours without configuration: the effective fleet file has taken it in already."""
    keep = ENV_ELSEWHERE - {"RECSLAM_ENDPOINT"}
    environment = {name: value for name, value in os.environ.items() if not name.startswith(ENV_PREFIX) or name in keep}
    for threads in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
        environment.setdefault(threads, "1")  # a service computes in processes, not in threads
    return environment


def _how(code: int) -> str:
    return f"was killed by {signal.Signals(-code).name}" if code < 0 else f"ended with exit code {code}"


def _obituary(name: str, code: int, path: Path) -> str:
    tail = path.read_text(errors="replace").splitlines()[-TAIL_LINES:]
    return "\n".join([f"{name} {_how(code)}; the end of {path}:", *(f"  {line}" for line in tail)])
