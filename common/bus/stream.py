"""From Zenoh's threads into one `async for`, bounded: when the consumer is slow the oldest go, and are counted."""

from __future__ import annotations

import asyncio
import threading
from collections import deque
from collections.abc import Callable
from typing import Any, Generic, Protocol, TypeVar

T = TypeVar("T")

BREATH = 32
"""items handed out in a row before the loop's other tasks get their turn"""


class Declared(Protocol):
    """What was declared at Zenoh and must be taken back."""

    def undeclare(self) -> Any: ...


class Stream(Generic[T]):
    """An async iterator for one consumer; it ends when it or the bus is closed.

    Zenoh's ring channel drops in silence, so a reader thread empties it at once into the deque here, which is where
    samples are dropped and counted. Decoding happens when the consumer takes an item: what is dropped costs nothing.
    """

    def __init__(
        self,
        loop: asyncio.AbstractEventLoop,
        depth: int,
        accept: Callable[[Any], T | None],
        dropped: Callable[[int], None],
    ) -> None:
        """`accept` turns a raw item into what is yielded (None: skip it); `dropped` is told, on the loop, how
        many were lost."""
        self.depth = depth
        self.dropped = 0
        self._untold = 0
        self._loop = loop
        self._accept = accept
        self._tell_dropped = dropped
        self._items: deque[Any] = deque()
        self._lock = threading.Lock()
        self._event = asyncio.Event()
        self._waking = False
        self.closed = False
        """nothing more will come"""
        self._taken = 0
        self._declared: list[Declared] = []

    def hold(self, declared: Declared) -> None:
        """Keep what feeds this stream: Zenoh undeclares a channel subscriber that nobody holds."""
        self._declared.append(declared)

    def push(self, item: Any) -> None:
        """Add an item; from any thread, never blocks."""
        with self._lock:
            if len(self._items) >= self.depth:
                self._items.popleft()
                self.dropped += 1
                self._untold += 1
            self._items.append(item)
        self._wake()

    def read(self, items: Any) -> threading.Thread:
        """Push all of a Zenoh channel's items from a thread of its own, until the channel is closed."""

        def run() -> None:
            for item in items:
                self.push(item)
            self.finish()

        # no daemon: a daemon thread inside Zenoh aborts the interpreter at exit; the bus joins it
        thread = threading.Thread(target=run, name="bus-reader", daemon=False)
        thread.start()
        return thread

    def finish(self) -> None:
        """Nothing more will come; from any thread. What is here can still be taken."""
        self.closed = True
        self._wake()

    def close(self) -> None:
        """Stop receiving; idempotent."""
        for declared in self._declared:
            declared.undeclare()
        self._declared.clear()
        self.finish()

    def __len__(self) -> int:
        return len(self._items)

    def __aiter__(self) -> Stream[T]:
        return self

    async def __anext__(self) -> T:
        while True:
            self._taken += 1
            if self._taken % BREATH == 0:
                await asyncio.sleep(0)
            with self._lock:
                item = self._items.popleft() if self._items else None
                if item is None:
                    self._event.clear()
            if item is not None:
                accepted = self._accept(item)
                if accepted is not None:
                    return accepted
            elif self.closed:
                raise StopAsyncIteration
            else:
                await self._event.wait()

    def _wake(self) -> None:
        """Schedule at most one wake-up on the loop, however many items come before it runs."""
        with self._lock:
            if self._waking:
                return
            self._waking = True
        try:
            self._loop.call_soon_threadsafe(self._woken)
        except RuntimeError:  # the loop is closed: nobody will take anything any more
            self.closed = True

    def _woken(self) -> None:
        with self._lock:
            self._waking = False
            lost, self._untold = self._untold, 0
        if lost:
            self._tell_dropped(lost)
        self._event.set()
