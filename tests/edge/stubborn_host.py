"""A SLAM host whose scans may never end."""

import threading
import time


class StubbornHost:
    def warm(self, kernel: str) -> None:
        pass

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
