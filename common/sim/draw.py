"""Pictures of scenes, drawn with OpenCV."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from common.sim.scene import Scene

SHADES = [(180, 60, 30), (40, 130, 220), (60, 160, 60), (160, 60, 160), (30, 30, 200), (150, 150, 20), (20, 90, 140)]
"""BGR"""


def draw_scene(
    scene: Scene, side: int = 1200, points: Mapping[str, NDArray[np.float64]] | None = None
) -> NDArray[np.uint8]:
    """A BGR picture (h, w, 3) whose longer side has about `side` pixels: walls, routes by colour, named points in red.

    `points` maps a label to points (n, 2) in metres.
    """
    import cv2

    x0, y0, x1, y1 = scene.world.bounds
    scale = side / max(x1 - x0, y1 - y0)
    picture = np.full((int((y1 - y0) * scale) + 40, int((x1 - x0) * scale) + 40, 3), 255, np.uint8)

    def pixels(place: NDArray[np.float64]) -> NDArray[np.int32]:
        flat = (np.asarray(place) - [x0, y0]) * scale + 20
        flat[..., 1] = picture.shape[0] - flat[..., 1]
        return np.rint(flat).astype(np.int32)

    for a, b in zip(pixels(scene.world.segments[:, :2]), pixels(scene.world.segments[:, 2:]), strict=True):
        cv2.line(picture, a.tolist(), b.tolist(), (0, 0, 0), 1, cv2.LINE_AA)
    for number, (name, way) in enumerate(scene.routes.items()):
        shade, line = SHADES[number % len(SHADES)], pixels(way) + number % 5 * 2 - 4
        cv2.polylines(picture, [line], False, shade, 1, cv2.LINE_AA)
        cv2.circle(picture, line[0].tolist(), 4, shade, -1)
        cv2.putText(picture, name, (line[0] + 6).tolist(), cv2.FONT_HERSHEY_SIMPLEX, 0.5, shade, 1, cv2.LINE_AA)
    for label, group in (points or {}).items():
        dots = pixels(group)
        picture[dots[:, 1], dots[:, 0]] = (0, 0, 255)
        cv2.putText(picture, label, (24, 16), cv2.FONT_HERSHEY_SIMPLEX, 0.5, (0, 0, 255), 1, cv2.LINE_AA)
    return picture
