"""A SLAM host whose scans may never end, and that takes only checkpoints it likes."""

import threading
import time
from typing import Any


class StubbornHost:
    lives: tuple[int, ...] = ()
    """of the instances opened, in order"""

    def warm(self, kernel: str) -> None:
        pass

    def open(self, robot: str, life: int, snapshot: bytes = b"", **settings: Any) -> None:
        if snapshot == b"foreign":
            raise ValueError("of another kernel")
        self.lives += (life,)

    def opened(self) -> tuple[int, ...]:
        return self.lives

    def process(self, robot: str, data: str) -> str:
        while data == "spin":
            pass
        if data == "sleep":
            time.sleep(3600)
        return data

    def finish(self, robot: str) -> None:
        begin = time.process_time()
        while time.process_time() - begin < 0.6:
            pass


class ThreadedHost(StubbornHost):
    def warm(self, kernel: str) -> None:
        threading.Thread(target=time.sleep, args=(3600,), daemon=True).start()


class StuckHost(StubbornHost):
    """Every scan is one too many; there is a new map each time that one asks."""

    version = 0

    def process(self, robot: str, data: bytes) -> str:
        return super().process(robot, "sleep")

    def news(self, robot: str) -> dict[str, Any]:
        self.version += 1
        told = {"version": self.version, "resolution": 0.05, "seq": -1, "final": False}
        return told | {"corrections": 0, "corrected_m": 0.0, "slam_s": 0.0, "scan_s": 0.0}
