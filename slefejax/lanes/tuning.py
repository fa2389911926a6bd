"""How kernels run: every number that another machine may want otherwise. But for rounding none changes results."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any


@dataclass(frozen=True)
class Tuning:
    """Measured on CPUs of two kinds (docs/layout.md).

    lanes                 : patches of a chunk, whose arrays the cache holds
    numbers               : of a net in a chunk at most, if it is not unrolled
    fewest_lanes          : of a chunk
    fewest_chunks         : at all. There are no loops over one chunk: XLA makes straight code of it, which takes twice
                            as long in gradients
    few_chunks            : up to so many their number is rounded up to two sizes an octave, then to eight
    fewest_shared         : chunks for a core: with fewer of them threads cost more than they save
    blocks                : items of a call of which every call has another number
    cells                 : cells or triangles of a call; a program more would take longer than calls that are not full
    page                  : patches that one program finds the cells of
    sampled               : items of a chunk of which each has a hundred samples with derivatives
    gathered              : items of a chunk that some of all items are gathered into
    turned                : patches of a chunk whose normals are bounded
    most_maps             : of the 65,530 mappings of memory that Linux allows
    unrolled_coefficients : of a control net, one array each
    unrolled_boxes        : of slefes, one array each
    unrolled_entries      : of a slefe's table, one number each
    unrolled_sums         : numbers of a control net whose sizes are added one by one
    many_nets             : from so many on unrolled code, which takes three times as long to compile, is worth it
    compiler_options      : by the backend's name. CPUs with registers of 512 bits are told to use them: up to a fifth
                            faster than what the compiler prefers. What loops over the tiles of a chunk could have in
                            common stays inside of them: to load a hundred arrays takes longer

    >>> Tuning(lanes=512).lanes, TUNING.lanes
    (512, 2048)
    """

    lanes: int = 2048
    numbers: int = 16_384
    fewest_lanes: int = 16
    fewest_chunks: int = 2
    few_chunks: int = 16
    fewest_shared: int = 2
    blocks: tuple[int, ...] = (128, 1024, 8192)
    cells: int = 1024
    page: int = 1024
    sampled: int = 128
    gathered: int = 512
    turned: int = 128
    most_maps: int = 40_000
    unrolled_coefficients: int = 16
    unrolled_boxes: int = 25
    unrolled_entries: int = 32
    unrolled_sums: int = 128
    many_nets: int = 30_000
    compiler_options: dict[str, dict[str, Any]] = field(
        default_factory=lambda: {
            "cpu": {
                "xla_cpu_prefer_vector_width": 512,
                "xla_disable_hlo_passes": "while-loop-invariant-code-motion",
            }
        }
    )


TUNING = Tuning()
