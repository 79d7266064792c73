"""Asks queries and collects the answers."""

from __future__ import annotations

import asyncio
import logging
from collections.abc import AsyncIterator, Mapping
from concurrent.futures import Executor

import zenoh
from zenoh.handlers import Callback

from common.bus.intake import Intake, Received, sender_of
from common.errors import BadMessage, QueryFailed, UsageError
from common.wire import Message, Refusal, decode

log = logging.getLogger(__name__)

SETTLE_S = 2.0


class Asker:
    """The asking side of one bus."""

    def __init__(self, session: zenoh.Session, root: str, intake: Intake, sender: Executor) -> None:
        """`sender` is where queries are sent from: a full link makes them wait, which the loop must not."""
        self._session = session
        self._root = root
        self._intake = intake
        self._sender = sender
        self._loop = asyncio.get_running_loop()

    async def get(
        self, key: str, params: Mapping[str, str | int], *, timeout_s: float, everyone: bool
    ) -> list[Received]:
        """See Bus.get."""
        replies = await self._replies(selector(f"{self._root}/{key}", params), timeout_s, everyone)
        answers: list[Received] = []
        failures: list[str] = []
        for reply in replies:
            if reply.ok is not None:
                by = str(reply.ok.key_expr).removeprefix(f"{self._root}/")
                received = self._intake.accept(by, reply.ok.payload)
                if received is None:
                    failures.append(self._intake.problems[-1])
                else:
                    answers.append(received)
            elif reply.err is not None:
                failures.append(self._reason(key, reply.err.payload.to_bytes(), timeout_s))
        if failures and not answers:
            raise QueryFailed("; ".join(failures), key)
        for failure in failures:
            log.info("one answer of several to %s failed: %s", key, failure)
        return answers

    async def pages(self, key: str, params: Mapping[str, str | int], *, timeout_s: float) -> AsyncIterator[Message]:
        """See Bus.pages."""
        asked = dict(params)
        seen: set[str] = set()
        while True:
            answers = await self.get(key, asked, timeout_s=timeout_s, everyone=False)
            if not answers:
                raise QueryFailed("nobody answers; is its owner up?", key)
            page = answers[0].message
            yield page
            cursor = getattr(page, "next", None)
            if cursor is None:
                return
            if str(cursor) in seen:
                raise QueryFailed(f"pages go round in a circle at cursor {cursor!r}", key)
            seen.add(str(cursor))
            asked["cursor"] = cursor

    async def settle(self) -> None:
        """Wait until the router has taken in all that this bus has declared so far: it answers in order.

        Without a router there is nothing to wait for: it is told everything when it is back.
        """
        for router in self._session.info.routers_zid():
            await self._replies(zenoh.Selector(f"@/{router}/router"), SETTLE_S, False)

    async def _replies(self, asked: zenoh.Selector, timeout_s: float, everyone: bool) -> list[zenoh.Reply]:
        replies: list[zenoh.Reply] = []
        done: asyncio.Future[None] = self._loop.create_future()
        token = zenoh.CancellationToken()

        def resolve() -> None:
            if not done.done():
                done.set_result(None)

        def finish() -> None:
            try:
                self._loop.call_soon_threadsafe(resolve)
            except RuntimeError:
                log.debug("answer to %s after the loop was closed", asked)

        def ask() -> None:
            if not token.is_cancelled:
                self._session.get(
                    asked,
                    Callback(replies.append, finish, indirect=False),
                    target=zenoh.QueryTarget.ALL if everyone else zenoh.QueryTarget.BEST_MATCHING,
                    consolidation=zenoh.ConsolidationMode.NONE if everyone else zenoh.ConsolidationMode.AUTO,
                    timeout=timeout_s,
                    cancellation_token=token,
                )

        try:
            await self._loop.run_in_executor(self._sender, ask)
            await done
        except asyncio.CancelledError:
            token.cancel()
            raise
        return replies

    def _reason(self, key: str, payload: bytes, timeout_s: float) -> str:
        if payload == b"Timeout":
            return f"no answer within {timeout_s:g} s"
        try:
            message = decode(payload, sender_of(key))
        except BadMessage:
            return f"an error of {len(payload)} bytes that is no Refusal"
        return message.reason if isinstance(message, Refusal) else f"an error reply of kind {type(message).__name__}"


def selector(key: str, params: Mapping[str, str | int]) -> zenoh.Selector:
    """Key and parameters as Zenoh wants them. Raises UsageError on a parameter that would not arrive as it is."""
    for name, value in params.items():
        if not name or set(name) & set(";=|&#?") or set(str(value)) & set(";|#"):
            raise UsageError(f"query parameter {name}={value}: leave out the signs ; | #")
    return zenoh.Selector(key, {name: str(value) for name, value in params.items()})
