"""A small plot with logarithmic axes, drawn with OpenCV."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import cv2
import numpy as np

WIDTH, HEIGHT, MARGIN = 720, 480, 70
SHADES = [(180, 60, 30), (40, 130, 220), (60, 160, 60), (160, 60, 160)]
"""BGR"""


def draw_lines(lines: Mapping[str, Sequence[tuple[float, float]]], x: str, y: str, path: Path) -> None:
    """Each line through its (x, y) points, all above 0; `x` and `y` name the axes."""
    points = np.log10(np.concatenate([np.asarray(line, dtype=np.float64) for line in lines.values()]))
    low, high = np.floor(points.min(axis=0)), np.ceil(points.max(axis=0))
    span = np.maximum(high - low, 1)
    picture = np.full((HEIGHT, WIDTH, 3), 255, np.uint8)

    def pixel(place: np.ndarray) -> tuple[int, int]:
        across, up = (place - low) / span * [WIDTH - 2 * MARGIN, HEIGHT - 2 * MARGIN]
        return int(MARGIN + across), int(HEIGHT - MARGIN - up)

    def write(text: str, at: tuple[int, int], shade: tuple[int, int, int] = (0, 0, 0)) -> None:
        cv2.putText(picture, text, at, cv2.FONT_HERSHEY_SIMPLEX, 0.45, shade, 1, cv2.LINE_AA)

    for axis in (0, 1):
        for power in np.arange(low[axis], high[axis] + 1):
            ends = [low.copy(), high.copy()]
            ends[0][axis] = ends[1][axis] = power
            one, two = pixel(ends[0]), pixel(ends[1])
            cv2.line(picture, one, two, (220, 220, 220), 1)
            write(f"{10.0**power:g}", (one[0] - 12, one[1] + 20) if axis == 0 else (one[0] - 55, one[1] + 5))
    for number, (name, line) in enumerate(lines.items()):
        shade = SHADES[number % len(SHADES)]
        dots = [pixel(np.log10(np.asarray(place, dtype=np.float64))) for place in line]
        cv2.polylines(picture, [np.array(dots, np.int32)], False, shade, 2, cv2.LINE_AA)
        for dot in dots:
            cv2.circle(picture, dot, 4, shade, -1, cv2.LINE_AA)
        write(name, (MARGIN + 12, MARGIN + 20 * (number + 1)), shade)
    write(x, (WIDTH // 2, HEIGHT - 20))
    write(y, (12, MARGIN - 20))
    cv2.imwrite(str(path), picture)
