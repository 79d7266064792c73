"""`python -m common.sim SCENE OUT.png` draws a scene with its routes."""

from __future__ import annotations

import argparse
import sys

from common.errors import UsageError
from common.sim.draw import draw_scene
from common.sim.scene import BUILT_IN, load_scene


def main() -> int:
    parser = argparse.ArgumentParser(prog="python -m common.sim", description="Draw a scene with its routes.")
    parser.add_argument("scene", help=f"a map_server .yaml, or one of: {', '.join(BUILT_IN)}")
    parser.add_argument("picture", help="file to write, .png")
    arguments = parser.parse_args()
    import cv2

    try:
        picture = draw_scene(load_scene(arguments.scene))
    except UsageError as error:
        print(error, file=sys.stderr)
        return 2
    if not cv2.imwrite(arguments.picture, picture):
        print(f"cannot write {arguments.picture}", file=sys.stderr)
        return 2
    return 0


if __name__ == "__main__":
    sys.exit(main())
