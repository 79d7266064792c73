"""A class for worker tests."""

import os
import signal
import threading
import time
from pathlib import Path


class Calculator:
    rounds = 0
    """of what can wait, done"""
    asked = 0
    tired = False

    def idle(self) -> bool:
        if self.tired:
            raise ValueError("not now")
        self.rounds = min(self.rounds + 1, self.asked)
        return self.rounds < self.asked

    def later(self, rounds: int) -> None:
        self.asked += rounds

    def done(self) -> int:
        return self.rounds

    def tire(self) -> None:
        self.tired = True

    def warm(self, how: str) -> None:
        if how == "fail":
            raise ValueError("too cold")
        if how == "thread":
            threading.Thread(target=time.sleep, args=(60,), daemon=True).start()
        if how == "spin":
            Path("/proc/self/comm").write_text("spinning")
            while True:
                pass
        self.rounds = self.asked = 7

    def add(self, a: int, b: int) -> int:
        return a + b

    def fail(self) -> None:
        raise ValueError("no such sum")

    def pid(self) -> int:
        return os.getpid()

    def die(self) -> None:
        os.kill(os.getpid(), signal.SIGKILL)

    def spin(self) -> None:
        while True:
            time.sleep(0.01)
