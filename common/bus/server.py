"""Answers queries: latched values to a plain get, handlers to one with parameters."""

from __future__ import annotations

import asyncio
import logging
from collections.abc import Awaitable, Callable, Mapping
from concurrent.futures import Executor
from dataclasses import dataclass

import zenoh
from zenoh.handlers import Callback

from common.bus.intake import Intake
from common.errors import RecslamError, UsageError
from common.wire import Message, Refusal, encode

log = logging.getLogger(__name__)

Handler = Callable[[str, Mapping[str, str]], Awaitable[Message | None]]
"""(concrete key, parameters) → the answer; None: there is nothing under that key"""

MAX_RUNNING = 8
"""handlers that run at once"""
MAX_PENDING = 256
"""queries in hand; more are refused as busy"""

Replies = list[tuple[str, bytes]]


@dataclass
class Served:
    """One queryable and who answers it."""

    key_expr: str
    handler: Handler | None
    queryable: zenoh.Queryable[None] | None = None

    def covers(self, key: str) -> bool:
        return zenoh.KeyExpr(self.key_expr).includes(key)


class Server:
    """All queryables of one bus.

    A key may have a latched value and a handler (a notice, and the tiles that it announces): a query without parameters
    gets the latched value, one with parameters asks the handler. Exactly one queryable of this bus answers for a key.
    """

    def __init__(self, session: zenoh.Session, root: str, intake: Intake, replier: Executor) -> None:
        """`replier` is where replies are sent from: they block while the link is full, which the loop must not."""
        self._session = session
        self._root = root
        self._intake = intake
        self._replier = replier
        self._loop = asyncio.get_running_loop()
        self._latched: dict[str, bytes] = {}
        self._served: dict[str, Served] = {}
        self._slots = asyncio.Semaphore(MAX_RUNNING)
        self._tasks: set[asyncio.Task[None]] = set()
        self._waiting = 0

    def latch(self, key: str, data: bytes) -> None:
        """From now on `data` is the answer to a plain get of `key`."""
        self._latched[key] = data
        if not any(served.covers(key) for served in self._served.values()):
            self._declare(Served(key, None))

    def unlatch(self, key: str) -> None:
        """There is no latched value for `key` any more."""
        self._latched.pop(key, None)
        served = self._served.get(key)
        if served is not None and served.handler is None and served.queryable is not None:
            served.queryable.undeclare()
            del self._served[key]

    def serve(self, key_expr: str, handler: Handler) -> None:
        """From now on `handler` answers queries with parameters on `key_expr`."""
        old = self._served.get(key_expr)
        if old is not None and old.handler is not None:
            raise UsageError(f"{key_expr} is served already")
        covered = [served for served in self._served.values() if served.handler is None]
        self._declare(Served(key_expr, handler))
        for served in covered:
            if zenoh.KeyExpr(key_expr).includes(served.key_expr) and served.queryable is not None:
                served.queryable.undeclare()
                if served.key_expr != key_expr:
                    del self._served[served.key_expr]

    async def close(self) -> None:
        """Take back all queryables and drop what is in hand: the askers get an empty answer."""
        for served in self._served.values():
            if served.queryable is not None:
                served.queryable.undeclare()
        for task in self._tasks:
            task.cancel()
        await asyncio.gather(*self._tasks, return_exceptions=True)

    def _declare(self, served: Served) -> None:
        def receive(query: zenoh.Query) -> None:
            try:
                self._loop.call_soon_threadsafe(self._admit, served, query)
            except RuntimeError:  # the loop is closed; the query is dropped and its asker told
                query.drop()

        # direct: it only schedules, and a thread for each latched key would be a crowd
        callback: Callback[zenoh.Query] = Callback(receive, indirect=False)
        served.queryable = self._session.declare_queryable(f"{self._root}/{served.key_expr}", callback)
        self._served[served.key_expr] = served

    def _admit(self, served: Served, query: zenoh.Query) -> None:
        task = self._loop.create_task(self._answer(served, query), name=f"query {served.key_expr}")
        self._tasks.add(task)
        task.add_done_callback(self._tasks.discard)

    async def _answer(self, served: Served, query: zenoh.Query) -> None:
        asked = str(query.key_expr).removeprefix(f"{self._root}/")
        replies: Replies = []
        refusal: bytes | None = None
        try:
            replies = await self._in_turn(served, asked, dict(query.parameters.__iter__()))
            self._intake.counters.served += 1
        except asyncio.CancelledError:
            query.drop()
            raise
        except Exception as error:
            refusal = self._failure(asked, error)
        await self._loop.run_in_executor(self._replier, self._send, query, replies, refusal)

    async def _in_turn(self, served: Served, asked: str, params: Mapping[str, str]) -> Replies:
        if self._waiting >= MAX_PENDING:
            raise UsageError(f"busy: {MAX_PENDING} queries are waiting; ask again later")
        self._waiting += 1
        try:
            async with self._slots:
                return await self._replies(served, asked, params)
        finally:
            self._waiting -= 1

    async def _replies(self, served: Served, asked: str, params: Mapping[str, str]) -> Replies:
        wild = "*" in asked
        if not params or served.handler is None:
            latched = [
                (key, data)
                for key, data in self._latched.items()
                if served.covers(key) and (zenoh.KeyExpr(asked).includes(key) if wild else asked == key)
            ]
            if latched or served.handler is None:
                return latched
        if wild and "*" in served.key_expr:
            raise UsageError(f"{asked} names several; ask for one key")
        key = served.key_expr if wild else asked
        message = await served.handler(key, params)
        return [] if message is None else [(key, encode(message))]

    def _failure(self, key: str, error: Exception) -> bytes:
        """Count and log a failed query; the error reply that tells its asker why."""
        self._intake.counters.failed += 1
        if isinstance(error, RecslamError):
            log.info("query on %s refused: %s", key, error)
            return encode(Refusal(reason=str(error)))
        log.error("query on %s failed", key, exc_info=error)
        return encode(Refusal(reason=f"{type(error).__name__}: {error}"))

    def _send(self, query: zenoh.Query, replies: Replies, refusal: bytes | None) -> None:
        try:
            with query:
                for key, data in replies:
                    query.reply(f"{self._root}/{key}", data)
                if refusal is not None:
                    query.reply_err(refusal)
        except zenoh.ZError as error:  # the asker is gone, or we are closing
            log.debug("reply not sent: %s", error)
