"""Broken files of every kind: one sentence, in little memory; never a crash, a hang or a traceback."""

from __future__ import annotations

from collections import Counter
from itertools import pairwise

import pytest

from tests.fuzzing import KINDS, MEGABYTES, Reader, reading

_EACH, _EACH_SLOW = 25, 1_500  # 400 and 24,000 cases


@pytest.fixture(scope="module")
def reader():
    pytest.importorskip("pxr", reason="usd-core is not installed")
    pytest.importorskip("rhino3dm", reason="rhino3dm is not installed")
    with reading() as found:
        yield found


def check(reader: Reader, kind: str, first: int, count: int) -> Counter[str]:
    """Read so many cases; what came of them."""
    outcomes: Counter[str] = Counter()
    for seed in range(first, first + count):
        found = reader.read((kind, seed))
        assert found["outcome"] in ("read", "refused"), found
        assert found["megabytes"] <= MEGABYTES, found
        if found["outcome"] == "refused":
            assert str(reader.folder) in found["said"], found
            assert "\n" not in found["said"], found
        outcomes[found["outcome"]] += 1
    return outcomes


@pytest.mark.parametrize("kind", KINDS)
def test_broken_files(reader, kind):
    assert check(reader, kind, 0, _EACH)["refused"] > 0


@pytest.mark.slow
@pytest.mark.parametrize("kind", KINDS)
def test_very_many_broken_files(reader, kind):
    outcomes = check(reader, kind, 1_000, _EACH_SLOW)
    assert outcomes["refused"] > outcomes["read"] > 0


def test_cases_can_be_made_again(reader):
    found = [reader.read(("obj", 7)) for _ in range(3)]
    for one, other in pairwise(found):
        assert (one["outcome"], one["said"]) == (other["outcome"], other["said"])


@pytest.mark.slow
def test_a_reader_that_dies_is_noticed(reader):
    """The harness itself: a process that ends, and one that never answers."""
    reader.close()
    process = reader._start()
    process.kill()
    assert reader.read(("obj", 1))["outcome"] == "crashed"
    assert reader.read(("obj", 1), patience=0.0)["outcome"] == "hung"
    assert reader.read(("obj", 1))["outcome"] in ("read", "refused")
