"""Limits that a message must keep, checked before anything is allocated."""

VERSION = 1
"""Version of the wire format; a message of another version is refused by name."""

MAX_MESSAGE_BYTES = 8 * 1024 * 1024
MAX_PAGE_BYTES = 256 * 1024
"""A query reply aims to stay below this: replies block the sender's link until they are taken."""
MAX_BEAMS = 16_384
MAX_SAMPLES = 4_096
"""Odometry or IMU samples in one frame."""
MAX_STAMP_S = 1e11
"""what is later is not in seconds"""
MAX_ANGLE_RAD = 100.0
"""what is more is not in radians"""
MAX_MOUNT_M = 100.0
MAX_RANGE_M = 100_000.0
"""more than any laser's reach, but for those that give a large number for no limit"""
MAX_TIME_INCREMENT_S = 10.0
MAX_ITEMS = 65_536
"""Entries in any list or mapping."""
MAX_TEXT_BYTES = 64 * 1024
NAME_PATTERN = r"^[A-Za-z0-9_-]{1,64}$"
"""Robots and edges have names, never numbers with a cap."""
