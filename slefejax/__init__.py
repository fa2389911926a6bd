"""How finely must a curved surface be tessellated so that no pixel shows the difference?

>>> import slefejax as sj
>>> scene = sj.load("teapot")
>>> view = sj.View(sj.Camera.look_at((4.5, -6.0, 4.0), (0.0, 0.0, 1.2)), width=1440, height=900)
>>> factors = sj.tessellation_factors(scene.patches(), view, tolerance=0.5)
"""

from importlib import import_module
from importlib.metadata import version
from typing import TYPE_CHECKING, Any

from slefejax import methods
from slefejax.bezier import evaluate_patches
from slefejax.bspline import bspline_slefe, bspline_slefe_boxes
from slefejax.budget import Budget, distance_for_budget, real_triangles, tolerance_for_budget
from slefejax.cameras import cameras_around
from slefejax.conversion.scheme import Conversion, convert
from slefejax.deviation import edge_turns, side_turns, surface_distance
from slefejax.errors import InputError, NoOpenGLError
from slefejax.factors import Factors, tessellation_factors
from slefejax.late import one_at_a_time
from slefejax.mesh import Mesh
from slefejax.minimal import minimal_factors, minimal_pairs
from slefejax.packed import pack
from slefejax.rig import Pose
from slefejax.samples import Samples, measure_factors
from slefejax.scene import Scene, load, save
from slefejax.sensitivity import Sensitivity, sensitivity
from slefejax.session import Session
from slefejax.skinning import dual_quaternion_blend, linear_blend
from slefejax.slefe import Slefe, SlefeTable, slefe, slefe_boxes, slefe_table
from slefejax.supremum import sampled_error, worst_points
from slefejax.tessellator import triangle_counts, with_pieces
from slefejax.tiles import slefe_tiles
from slefejax.triangles import triangle_error
from slefejax.triangulation import Triangulation, triangulate
from slefejax.view import Camera, View
from slefejax.widths import screen_twists, screen_widths

__version__: str  # of the installed package, read from its metadata when it is asked for

if TYPE_CHECKING:
    from slefejax.curves import curve_constant
    from slefejax.fitting import Fit, bootstrap_km, fit_km
    from slefejax.relaxing import Relaxed, fewer_triangles

# Modules that need packages which take long to import: imported when a name of theirs is first used.
_LATER = {
    "curves": ("curve_constant",),
    "fitting": ("Fit", "bootstrap_km", "fit_km"),
    "relaxing": ("Relaxed", "fewer_triangles"),
}
_MODULES = {name: module for module, names in _LATER.items() for name in names}

__all__ = [
    "Budget",
    "Camera",
    "Conversion",
    "Factors",
    "Fit",
    "InputError",
    "Mesh",
    "NoOpenGLError",
    "Pose",
    "Relaxed",
    "Samples",
    "Scene",
    "Sensitivity",
    "Session",
    "Slefe",
    "SlefeTable",
    "Triangulation",
    "View",
    "bootstrap_km",
    "bspline_slefe",
    "bspline_slefe_boxes",
    "cameras_around",
    "convert",
    "curve_constant",
    "distance_for_budget",
    "dual_quaternion_blend",
    "edge_turns",
    "evaluate_patches",
    "fewer_triangles",
    "fit_km",
    "linear_blend",
    "load",
    "measure_factors",
    "methods",
    "minimal_factors",
    "minimal_pairs",
    "pack",
    "real_triangles",
    "sampled_error",
    "save",
    "screen_twists",
    "screen_widths",
    "sensitivity",
    "side_turns",
    "slefe",
    "slefe_boxes",
    "slefe_table",
    "slefe_tiles",
    "surface_distance",
    "tessellation_factors",
    "tolerance_for_budget",
    "triangle_counts",
    "triangle_error",
    "triangulate",
    "with_pieces",
    "worst_points",
]

if not TYPE_CHECKING:  # a checker that saw it would take every misspelt name for one that is there

    def __getattr__(name: str) -> Any:
        if name == "__version__":
            return version(__name__)
        if name not in _MODULES:
            raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
        with one_at_a_time:
            return getattr(import_module(f"{__name__}.{_MODULES[name]}"), name)


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__, "__version__"})
