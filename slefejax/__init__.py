"""How finely must a curved surface be tessellated so that no pixel shows the difference?

>>> import slefejax as sj
>>> scene = sj.load("teapot")
>>> view = sj.View(sj.Camera.look_at((4.5, -6.0, 4.0), (0.0, 0.0, 1.2)), width=1440, height=900)
>>> factors = sj.tessellation_factors(scene.patches(), view, tolerance=0.5)
"""

import sys
from importlib import import_module
from importlib.metadata import version
from typing import TYPE_CHECKING, Any

from slefejax.bounds.bspline import bspline_slefe, bspline_slefe_boxes
from slefejax.bounds.slefe import Slefe, SlefeTable, slefe, slefe_boxes, slefe_table
from slefejax.bounds.tiles import slefe_tiles
from slefejax.bounds.widths import screen_twists, screen_widths
from slefejax.cameras import cameras_around
from slefejax.conversion.scheme import Conversion, convert
from slefejax.errors import InputError, NoOpenGLError
from slefejax.geometry.evaluate import evaluate_patches
from slefejax.geometry.gregory import GregoryPatches
from slefejax.geometry.packed import pack
from slefejax.geometry.view import Camera, View
from slefejax.lanes.programs import keep_programs
from slefejax.late import one_at_a_time
from slefejax.loading import load, save
from slefejax.measure.covering import covering_error
from slefejax.measure.error import drawn_error, exact_normals, normal_error, pixel_error
from slefejax.measure.jumps import edge_turns
from slefejax.measure.limit import LimitDistance, limit_distance
from slefejax.measure.minimal import minimal_factors, minimal_pairs
from slefejax.measure.normals import sampled_normal_error, triangle_normal_error, worst_normal_points
from slefejax.measure.rounding import rounding_error
from slefejax.measure.supremum import sampled_error, worst_points
from slefejax.measure.triangles import triangle_error
from slefejax.model.gaussians import Gaussians, covariance_parameters, covariances
from slefejax.model.mesh import Mesh
from slefejax.model.rig import Pose
from slefejax.model.skinning import dual_quaternion_blend, linear_blend
from slefejax.predict import methods
from slefejax.predict.factors import Factors, tessellation_factors
from slefejax.scene import Scene
from slefejax.session import Session
from slefejax.study.budget import Budget, distance_for_budget, real_triangles, tolerance_for_budget
from slefejax.study.deviation import side_turns, surface_distance
from slefejax.study.samples import Samples, measure_factors
from slefejax.study.sensitivity import Sensitivity, sensitivity
from slefejax.tessellator.levels import triangle_counts, with_pieces
from slefejax.tessellator.triangulation import Triangulation, triangulate

__version__: str  # of the installed package, read from its metadata when it is asked for

if TYPE_CHECKING:
    from slefejax.bounds.rivals import enclose_curve, enclose_surface
    from slefejax.experiments.grid.plan import Study
    from slefejax.study.curves import curve_constant
    from slefejax.study.fitting import Fit, bootstrap_km, fit_km
    from slefejax.study.relaxing import Relaxed, fewer_triangles

# Modules that need packages which take long to import: imported when a name of theirs is first used.
_LATER = {
    "bounds.rivals": ("enclose_curve", "enclose_surface"),
    "experiments.grid.plan": ("Study",),
    "study.curves": ("curve_constant",),
    "study.fitting": ("Fit", "bootstrap_km", "fit_km"),
    "study.relaxing": ("Relaxed", "fewer_triangles"),
}
_MODULES = {name: module for module, names in _LATER.items() for name in names}

__all__ = [
    "Budget",
    "Camera",
    "Conversion",
    "Factors",
    "Fit",
    "Gaussians",
    "GregoryPatches",
    "InputError",
    "LimitDistance",
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
    "Study",
    "Triangulation",
    "View",
    "bootstrap_km",
    "bspline_slefe",
    "bspline_slefe_boxes",
    "cameras_around",
    "convert",
    "covariance_parameters",
    "covariances",
    "covering_error",
    "curve_constant",
    "distance_for_budget",
    "drawn_error",
    "dual_quaternion_blend",
    "edge_turns",
    "enclose_curve",
    "enclose_surface",
    "evaluate_patches",
    "exact_normals",
    "fewer_triangles",
    "fit_km",
    "keep_programs",
    "limit_distance",
    "linear_blend",
    "load",
    "measure_factors",
    "methods",
    "minimal_factors",
    "minimal_pairs",
    "normal_error",
    "pack",
    "pixel_error",
    "real_triangles",
    "rounding_error",
    "sampled_error",
    "sampled_normal_error",
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
    "triangle_normal_error",
    "triangulate",
    "with_pieces",
    "worst_normal_points",
    "worst_points",
]

# Modules that documentation names, by the names that they had before they stood in folders.
_BEFORE = {
    "covering": "measure.covering",
    "edges": "tessellator.edges",
    "error": "measure.error",
    "rig": "model.rig",
    "rivals": "bounds.rivals",
    "skinning": "model.skinning",
}
for _name, _now in _BEFORE.items():
    globals()[_name] = sys.modules[f"{__name__}.{_name}"] = import_module(f"{__name__}.{_now}")

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
