"""What a worker may have, where a kernel tells less than others."""

import pytest

from ddpc_cosim.processes import limits


def test_where_shared_memory_is_not_told_all_of_it_counts(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(limits, "_resident", lambda pid: 2_000_000_000)
    nowhere = -1
    assert limits.excess_of(nowhere, 2_000_000_000) == ""
    assert limits.excess_of(nowhere, 1_500_000_000) == "more than 1.5 GB of memory"
