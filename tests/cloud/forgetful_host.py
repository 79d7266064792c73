"""A merging host that finds two maps merged, and corrects only a world that it has solved itself."""

from typing import Any

from common.wire import FixedPose, Placed, Transforms, Verdicts, encode


class ForgetfulHost:
    solved = False
    starts: Any = None
    """told for the last world"""

    def configure(self, settings: dict[str, Any]) -> None:
        pass

    def warm(self) -> None:
        pass

    def told(self) -> Any:
        return self.starts

    def solve(self, robots: list[str], starts: dict[str, Any], **more: Any) -> dict[str, Any]:
        self.solved, self.starts = True, starts
        placed = {r: Placed(transform=FixedPose.of(0.0, 0.0, 0.0), component="r1", version=1) for r in robots}
        world = Transforms(world_epoch=1, final=True, resolution=0.05, robots=placed, components=(), reason="final")
        verdicts = encode(Verdicts(owner="cloud", pairs=()))
        return {"transforms": encode(world), "verdicts": verdicts, "seconds": 0.0, "checks": 1, "merged": [robots]}

    def correct(self, transforms: bytes, **more: Any) -> dict[str, Any]:
        if not self.solved:
            raise KeyError("r1")
        return {"transforms": transforms, "seconds": 0.0}
