from __future__ import annotations

import jax
import numpy as np
import pytest

from slefejax import tessellation_factors, worst_points
from slefejax.cameras import cameras_around
from slefejax.gpu import Renderer
from slefejax.measure.error import drawn_error

_COMPILED = "/jax/core/compile/backend_compile_duration"


@pytest.mark.slow
def test_a_hundred_cameras_need_no_more_programs_than_the_first_few(teapot, device):
    """Factors, levels, draw, error image, sup error. What other tests of this process compiled is forgotten first."""
    jax.clear_caches()
    events: list[str] = []

    def listen(event: str, duration_secs: float, **kwargs: str | int) -> None:
        events.append(event)

    jax.monitoring.register_event_duration_secs_listener(listen)
    patches, programs = teapot.patches(), []
    renderer = Renderer(patches, device)
    try:
        for view in cameras_around(teapot, 160, 120, 100, 3):
            for method in ("slefe", "certified"):
                factors = tessellation_factors(patches, view, method, edge_numbers=teapot.edge_numbers)
                seen = renderer.draw(view, factors.inner, factors.edges)
                error = drawn_error(patches, view, seen)
                assert np.isfinite(error).any()
            worst_points(patches[:3], factors.levels[:3], view)
            programs.append(events.count(_COMPILED))
    finally:
        jax.monitoring.clear_event_listeners()
        renderer.release()
    assert programs[0] > 0, "otherwise nothing is counted"
    assert programs[-1] == programs[9]
