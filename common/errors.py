"""Every error that RecSLAM raises on purpose, under one root; each message says what to do next.

Two families: `UsageError` is ours or the operator's to mend; `PeerError` is something another party sent.
A `PeerError` is counted against its sender and harms nobody else.
"""

from __future__ import annotations


class RecslamError(Exception):
    """Root of all errors raised on purpose."""


class UsageError(RecslamError):
    """The operator or the calling code asked for something that cannot be done."""


class ConfigError(UsageError):
    """A configuration that does not validate; the message names the field."""


class RouterUnreachable(UsageError):
    """No Zenoh router answered at the endpoint within the time given."""


class BadFile(UsageError):
    """A file that cannot be read as what it should be; the message names file and place."""


class BadSweep(RecslamError):
    """A scan of a robot's own source that cannot travel; it is refused and counted, and the robot goes on."""


class SpoolFull(UsageError):
    """The disk under a robot's spool takes no more; the message says what to free."""


class Unmergeable(UsageError):
    """Maps that cannot be combined as asked (for example of different resolution without resampling)."""


class PeerError(RecslamError):
    """Something another party sent breaks the protocol."""

    def __init__(self, message: str, sender: str = "") -> None:
        super().__init__(f"{sender}: {message}" if sender else message)
        self.sender = sender


class BadMessage(PeerError):
    """A payload that is no valid message of this version."""


class QueryFailed(PeerError):
    """A query that was refused, timed out, or that nobody answered."""


class WorkerDied(RecslamError):
    """A worker process ended while it held work."""


class ServiceDied(RecslamError):
    """A service of a cluster ended by itself; the message has the end of its log."""


class MapTooLarge(RecslamError):
    """A robot seems to have gone farther than its kernel's map can reach; the message names another kernel."""


class SnapshotRefused(UsageError):
    """A SLAM snapshot that is foreign, corrupt or newer than this program."""
