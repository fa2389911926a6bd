"""How finely must a curved surface be tessellated so that no pixel shows the difference?

>>> import slefejax as sj
>>> scene = sj.load("teapot")
>>> view = sj.View(sj.Camera.look_at((4.5, -6.0, 4.0), (0.0, 0.0, 1.2)), width=1440, height=900)
>>> factors = sj.tessellation_factors(scene.patches(), view, segments=3, tolerance=0.5)
"""

from slefejax.bspline import bspline_slefe, bspline_slefe_boxes
from slefejax.conversion.scheme import Conversion, convert
from slefejax.errors import InputError, NoOpenGLError
from slefejax.factors import Factors, tessellation_factors
from slefejax.mesh import Mesh
from slefejax.minimal import minimal_factors, minimal_pairs
from slefejax.rig import Pose
from slefejax.scene import Scene, load, save
from slefejax.session import Session
from slefejax.skinning import dual_quaternion_blend, linear_blend
from slefejax.slefe import Slefe, SlefeTable, slefe, slefe_boxes, slefe_table
from slefejax.supremum import sampled_error, worst_points
from slefejax.tiles import slefe_tiles
from slefejax.triangles import triangle_error
from slefejax.view import Camera, View

__all__ = [
    "Camera",
    "Conversion",
    "Factors",
    "InputError",
    "Mesh",
    "NoOpenGLError",
    "Pose",
    "Scene",
    "Session",
    "Slefe",
    "SlefeTable",
    "View",
    "bspline_slefe",
    "bspline_slefe_boxes",
    "convert",
    "dual_quaternion_blend",
    "linear_blend",
    "load",
    "minimal_factors",
    "minimal_pairs",
    "sampled_error",
    "save",
    "slefe",
    "slefe_boxes",
    "slefe_table",
    "slefe_tiles",
    "tessellation_factors",
    "triangle_error",
    "worst_points",
]
