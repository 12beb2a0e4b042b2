"""Files from strangers: what was found, and some hundred mutations of every format."""

import formats
import pytest
from substep.base import apart

READ = {"a million fill values", "obj: 900,000 corners"}  # these are files like others


@pytest.mark.filterwarnings("ignore")
def test_past_findings(monkeypatch):
    """Each is refused in a second, with 2 GiB of memory."""
    monkeypatch.setattr(apart, "SECONDS", 1)
    got = formats.relive()
    expected = {why: ("read" if why in READ else "refused", "") for why in got}
    assert got == expected


def test_mutations():
    result = formats.attack(1000, seed=1)
    assert result["wrong"] == 0, result["findings"]
    tallies = [result["formats"][f.name] for f in formats.FORMATS if f.weight > formats.MESHIO]
    assert min(sum(tally.values()) for tally in tallies) > 10
    read = sum(tally["read"] for tally in tallies)
    assert 100 < read < 900  # else the mutations are too weak, or nothing can be read at all
