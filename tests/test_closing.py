from __future__ import annotations

from collections import Counter

import pytest

from tests.closing import closing_line

NO_MODELS = "the folder of models is not beside the checkout"


@pytest.mark.parametrize(
    ("counts", "reasons", "slow", "seconds", "line"),
    [
        (
            {"passed": 1767, "skipped": 3, "": 5000},
            {NO_MODELS: 3},
            96,
            552.4,
            f"All is well: 1,767 tests passed, 3 were skipped ({NO_MODELS}), 96 slow ones are left for `make slow`;"
            " 9 min 12 s.",
        ),
        ({"passed": 1}, {}, 0, 0.2, "All is well: 1 test passed; 0 s."),
        (
            {"passed": 7, "failed": 2, "error": 1, "skipped": 3},
            {"no OpenGL": 2, NO_MODELS: 1},
            1,
            60,
            "Something is wrong: 3 of 10 tests failed (why stands above),"
            f" 3 were skipped (2: no OpenGL; 1: {NO_MODELS}), 1 slow one is left for `make slow`; 1 min 0 s.",
        ),
        ({"deselected": 4}, {}, 4, 3, ""),
    ],
)
def test_closing_line(counts, reasons, slow, seconds, line):
    assert closing_line(counts, Counter(reasons), slow, seconds) == line


def test_closing_line_of_a_run_that_was_broken_off():
    assert closing_line({"passed": 4}, Counter(), 0, 1, False).startswith("The run was broken off")
    assert closing_line({"passed": 4, "error": 1}, Counter(), 0, 1, False).startswith("Something is wrong: 1 of 5")
