"""Numbers that queries give as text."""

from __future__ import annotations

import pytest

from common.bus.parameters import number
from common.errors import UsageError
from common.grid.versions import first_version


@pytest.mark.parametrize("text", ["", "x", "-1", "1.5", "²", "9" * 19, "9" * 5000])
def test_a_version_that_is_none_is_refused_by_the_name_of_its_parameter(text: str) -> None:
    with pytest.raises(UsageError, match="parameter since="):
        number({"since": text}, "since")
    assert number({}, "since") == 0
    assert number({"since": str(first_version(2**32 - 1))}, "since") == first_version(2**32 - 1)
