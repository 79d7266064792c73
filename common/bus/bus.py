"""The one bridge between asyncio and Zenoh: streams, latched values, queries, liveliness and the state of the link."""

from __future__ import annotations

import asyncio
import logging
import threading
from collections import deque
from collections.abc import AsyncIterator, Callable, Mapping
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from types import TracebackType
from typing import Any, TypeVar

import zenoh
from zenoh import CongestionControl, ext
from zenoh.handlers import Callback, RingChannel

from common.bus.asking import Asker
from common.bus.events import Alive, Link
from common.bus.intake import Counters, Intake, Received
from common.bus.opening import close_with_process, open_session
from common.bus.server import Handler, Server
from common.bus.stream import Declared, Stream
from common.errors import UsageError
from common.wire import Message, encode

log = logging.getLogger(__name__)

T = TypeVar("T")

ENCODING = "application/msgpack"
HEARTBEAT_S = 1.0
"""how soon a lost latched update is noticed and fetched again"""
CROWD_DEPTH = 4096
"""latched values, and liveliness and link events, kept for a slow consumer: whoever begins to watch a key of all robots
gets a burst with one of each, and so on a router's return; what is lost of it may never be told again"""


class Bus:
    """A session with the router. All keys, given and received, are relative to `root`.

    Close it on every path out: `async with await Bus.open(...) as bus`.
    """

    def __init__(self, session: zenoh.Session, endpoint: str, root: str) -> None:
        self.endpoint = endpoint
        self.root = root
        self._session = session
        self._loop = asyncio.get_running_loop()
        self._intake = Intake()
        self._replier = ThreadPoolExecutor(1, thread_name_prefix="bus-reply")
        self._server = Server(session, root, self._intake, self._replier)
        self._asker = Asker(session, root, self._intake, self._replier)
        self._publishers: dict[str, ext.AdvancedPublisher] = {}
        self._streams: list[Stream[Any]] = []
        self._links: list[Stream[Link]] = []
        self._threads: list[threading.Thread] = []
        self._tokens: list[Declared] = []
        self._routers: set[str] = set()
        self._closed = False
        self._ended = threading.Event()
        self._start_thread(partial(close_with_process, session, self._ended), "bus-guard")
        listen: Callback[zenoh.TransportEvent] = Callback(partial(self._threadsafe, self._on_transport))
        self._listener = session.info.declare_transport_events_listener(listen, history=True)
        self._routers.update(str(zid) for zid in session.info.routers_zid())

    @classmethod
    async def open(
        cls, endpoint: str, *, name: str, role: str, root: str = "recslam/v1", timeout_s: float = 5.0
    ) -> Bus:
        """Connect to the router at `endpoint`. Raises RouterUnreachable after `timeout_s`."""
        return cls(await open_session(endpoint, name=name, role=role, timeout_s=timeout_s), endpoint, root)

    async def __aenter__(self) -> Bus:
        return self

    async def __aexit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        await self.close()

    async def close(self) -> None:
        """Take everything back, end all streams and threads. Idempotent."""
        if self._closed:
            return
        self._closed = True
        for stream in [*self._streams, *self._links]:
            stream.close()
        await self._server.close()
        await asyncio.shield(self._loop.run_in_executor(None, self._close_session))

    @property
    def connected(self) -> bool:
        return bool(self._routers)

    @property
    def counters(self) -> Counters:
        return self._intake.counters

    @property
    def problems(self) -> deque[str]:
        """The last refusals, each with its sender."""
        return self._intake.problems

    def put(self, key: str, message: Message) -> None:
        """Send on a stream; never waits. It is lost when the link is full or down: see `counters.unconnected`."""
        self._check_open()
        data = encode(message)
        self._session.put(f"{self.root}/{key}", data, encoding=ENCODING, congestion_control=CongestionControl.DROP)
        self._count_sent(data)

    async def latch(self, key: str, message: Message) -> None:
        """Set the value of `key`: those who watch it get it now or when they come, and a plain get reads it."""
        self._check_open()
        data = encode(message)
        new = key not in self._publishers
        if new:
            self._publishers[key] = ext.declare_advanced_publisher(
                self._session,
                f"{self.root}/{key}",
                encoding=ENCODING,
                congestion_control=CongestionControl.DROP,
                cache=ext.CacheConfig(1),
                sample_miss_detection=ext.MissDetectionConfig(heartbeat=HEARTBEAT_S, sporadic_heartbeat=None),
                publisher_detection=True,
            )
        self._server.latch(key, data)
        self._publishers[key].put(data)
        self._count_sent(data)
        if new:
            await self._asker.settle()

    async def unlatch(self, key: str) -> None:
        """Take the value of `key` back: who comes later finds none. Nothing happens when there is none."""
        self._check_open()
        publisher = self._publishers.pop(key, None)
        if publisher is not None:
            self._server.unlatch(key)
            publisher.undeclare()
            await self._asker.settle()

    def subscribe(self, key_expr: str, *, depth: int = 256) -> Stream[Received]:
        """What is put from now on."""
        self._check_open()
        stream = self._message_stream(depth)
        subscriber = self._session.declare_subscriber(f"{self.root}/{key_expr}", RingChannel(depth))
        self._feed(stream, subscriber, subscriber.handler)
        return stream

    def watch(self, key_expr: str, *, depth: int = CROWD_DEPTH) -> Stream[Received]:
        """The latched values there are, then all that is latched (or put), also by publishers that come later."""
        self._check_open()
        stream = self._message_stream(depth)
        subscriber = ext.declare_advanced_subscriber(
            self._session,
            f"{self.root}/{key_expr}",
            RingChannel(depth),
            history=ext.HistoryConfig(detect_late_publishers=True, max_samples=1),
            recovery=ext.RecoveryConfig(periodic_queries=None, heartbeat=True),
        )
        self._feed(stream, subscriber, subscriber.handler)
        return stream

    async def get(
        self, key: str, params: Mapping[str, str | int] = {}, *, timeout_s: float = 5.0, everyone: bool = False
    ) -> list[Received]:
        """Ask `key` once; `everyone` collects the answers of all who match, which a wildcard key needs.

        Empty when there is nobody (or nothing) to answer. Raises QueryFailed when there is no good answer but a
        refusal, or none within `timeout_s`.
        """
        self._check_open()
        return await self._asker.get(key, params, timeout_s=timeout_s, everyone=everyone)

    async def pages(
        self, key: str, params: Mapping[str, str | int] = {}, *, timeout_s: float = 5.0
    ) -> AsyncIterator[Message]:
        """Page after page: each one's `next` is passed as `cursor`, one outstanding. Raises QueryFailed."""
        self._check_open()
        async for page in self._asker.pages(key, params, timeout_s=timeout_s):
            yield page

    async def serve(self, key_expr: str, handler: Handler) -> None:
        """Answer queries on `key_expr` by `handler(key, params)`; its error becomes a Refusal to the asker.

        Where the key also has a latched value, a query without parameters gets that.
        """
        self._check_open()
        self._server.serve(key_expr, handler)
        await self._asker.settle()

    async def declare_alive(self, key: str) -> None:
        """Show a liveliness token until the bus is closed or this process dies."""
        self._check_open()
        self._tokens.append(self._session.liveliness().declare_token(f"{self.root}/{key}"))

    def watch_alive(self, key_expr: str) -> Stream[Alive]:
        """The tokens there are, and how they come and go."""
        self._check_open()

        def accept(sample: zenoh.Sample) -> Alive:
            return Alive(self._relative(sample.key_expr), sample.kind == zenoh.SampleKind.PUT)

        stream: Stream[Alive] = self._stream(CROWD_DEPTH, accept)
        callback: Callback[zenoh.Sample] = Callback(stream.push, stream.finish)
        key = f"{self.root}/{key_expr}"
        stream.hold(self._session.liveliness().declare_subscriber(key, callback, history=True))
        self._streams.append(stream)
        return stream

    def watch_link(self) -> Stream[Link]:
        """Whether the router is there now, and how it comes and goes."""
        self._check_open()
        stream: Stream[Link] = self._stream(CROWD_DEPTH, lambda link: link)
        stream.push(Link(self.connected))
        self._links.append(stream)
        return stream

    def _message_stream(self, depth: int) -> Stream[Received]:
        def accept(sample: zenoh.Sample) -> Received | None:
            stamped = sample.timestamp.get_time().timestamp() if sample.timestamp is not None else 0.0
            return self._intake.accept(self._relative(sample.key_expr), sample.payload, stamped)

        return self._stream(depth, accept)

    def _stream(self, depth: int, accept: Callable[[Any], T | None]) -> Stream[T]:
        return Stream(self._loop, depth, accept, self._count_dropped)

    def _feed(self, stream: Stream[Received], declared: Declared, items: Any) -> None:
        stream.hold(declared)
        self._streams = [other for other in self._streams if not other.closed]
        self._streams.append(stream)
        self._threads = [thread for thread in self._threads if thread.is_alive()]
        self._threads.append(stream.read(items))

    def _count_dropped(self, lost: int) -> None:
        self.counters.dropped += lost

    def _count_sent(self, data: bytes) -> None:
        self.counters.sent += 1
        self.counters.sent_bytes += len(data)
        if not self.connected:
            self.counters.unconnected += 1

    def _relative(self, key_expr: zenoh.KeyExpr) -> str:
        return str(key_expr).removeprefix(f"{self.root}/")

    def _check_open(self) -> None:
        if self._closed:
            raise UsageError("the bus is closed; open another one")

    def _threadsafe(self, function: Callable[[Any], None], event: Any) -> None:
        try:
            self._loop.call_soon_threadsafe(function, event)
        except RuntimeError:
            log.debug("event after the loop was closed: %s", event)

    def _on_transport(self, event: zenoh.TransportEvent) -> None:
        before = self.connected
        zid = str(event.transport.zid)
        if event.kind == zenoh.SampleKind.PUT:
            self._routers.add(zid)
        else:
            self._routers.discard(zid)
        if self.connected != before:
            log.log(
                logging.INFO if self.connected else logging.WARNING,
                "router %s: %s",
                self.endpoint,
                "connected" if self.connected else "lost, reconnecting",
            )
            for stream in self._links:
                stream.push(Link(self.connected))

    def _start_thread(self, target: Callable[[], None], name: str) -> None:
        thread = threading.Thread(target=target, name=name, daemon=False)
        thread.start()
        self._threads.append(thread)

    def _close_session(self) -> None:
        """Blocking part of closing: undeclare first, then the session, then join what read from it."""
        try:
            for declared in [*self._tokens, *self._publishers.values(), self._listener]:
                declared.undeclare()
            self._session.close()
        finally:
            self._ended.set()
            self._replier.shutdown(wait=True, cancel_futures=True)
            for thread in self._threads:
                thread.join()
