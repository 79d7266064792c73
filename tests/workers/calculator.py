"""A class for worker tests."""

import os
import signal
import time


class Calculator:
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
