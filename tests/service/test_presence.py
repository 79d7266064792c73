"""Nobody is missed while the router is away."""

from __future__ import annotations

from common.presence import Presence, RouterLink, seen


def test_absence_counts_from_when_a_peer_went() -> None:
    known: dict[str, Presence] = {}
    link = RouterLink()
    seen(known, "r1", True, 1.0)
    assert link.missed_for(known["r1"], 50.0) == 0
    seen(known, "r1", False, 60.0)
    seen(known, "r1", False, 70.0)
    assert link.missed_for(known["r1"], 75.0) == 15.0
    seen(known, "r1", True, 80.0)
    assert link.missed_for(known["r1"], 90.0) == 0


def test_absence_counts_from_the_routers_return() -> None:
    link, gone = RouterLink(), Presence(alive=False, since=10.0)
    link.changed(False, 20.0)
    assert link.missed_for(gone, 500.0) == 0
    link.changed(True, 600.0)
    link.changed(True, 605.0)
    assert (link.up_for(610.0), link.missed_for(gone, 610.0)) == (10.0, 10.0)
