"""An offender as a script that needs nothing but NumPy and the package, and no randomness."""

from __future__ import annotations

from pprint import pformat

import numpy as np

from slefejax.experiments.attack.settings import SETTINGS
from slefejax.experiments.store import Row

_SCRIPT = '''"""{title}

python THIS asks the package again and judges what it says now; python THIS --claimed judges what it said then: {claim}.
Prints the ratio of the error to the tolerance; exit status 1 if that is above 1. {judged_by}
"""

import sys
from math import comb

import numpy as np
{imports}
eye, target, up, extent, near, far, perspective, width, height = {look}
tolerance, depth_tolerance, normal_tolerance = {tolerances}
patches = np.array({patches}).reshape({shape})
twists = np.array({twists})  # of Gregory patches
tangents = {tangents}  # of patches that are shaded with tangent patches, along u and along v
# of Gaussian products: of the patch that is judged 4 x 4 points (Q 11, 12, 13, 22, 23, 33, h), scale and offset
products = {products}
which = {which}  # the patch that is judged
triangle, share = np.array({triangle}), np.array({share})  # where the error was largest, in the domain
{claimed}

def given():
    import slefejax as sj

    made = patches.astype("{dtype}")
    return sj.GregoryPatches(made, twists.astype("{dtype}")) if twists.size else made


def predicted():
    import jax

    import slefejax as sj

    jax.config.update("jax_enable_x64", {double})
    make = sj.Camera.look_at if perspective else sj.Camera.orthographic
    view = sj.View(make(eye, target, up, extent, near, far), width, height)
    asked = {{"tolerance": tolerance, "depth_tolerance": depth_tolerance, "normal_tolerance": normal_tolerance}}
    if tangents:
        asked |= {{"normals": "tangents", "tangents": [np.array(own, "{dtype}") for own in tangents]}}
    return sj.tessellation_factors(given(), view, **asked{options})


def long(x):
    return np.asarray(x).astype(np.longdouble)


{measure}
{judge}

if __name__ == "__main__":
    found = worst("--claimed" in sys.argv[1:])
    print(f"ratio {{found:.12g}}")
    sys.exit(found > 1 + 4e-9)
'''

_POSITIONS = '''def screen():
    """What X, Y, Z over their tolerances from the picture's centre, and W are at (u, v); half the picture over them."""
    forward = long(target) - long(eye)
    forward /= np.sqrt(forward @ forward)
    right = np.cross(forward, long(up))
    right /= np.sqrt(right @ right)
    n, f, e = long([near, far, extent])
    scale = long([tolerance, tolerance, depth_tolerance or 1.0])

    def rows_of(control, w):
        x, y, z = ((control - w * long(eye)) @ np.stack([right, np.cross(right, forward), -forward]).T).T
        w = w[..., 0].T
        if perspective:
            pixels = height / 2 / np.tan(e * np.longdouble("3.14159265358979323846264338327950288") / 360)
            rows = pixels * x, pixels * y, (f + n) / (n - f) / 2 * z + f * n / (n - f) * w, -z
        else:
            rows = height / e * x, height / e * y, z / (n - f) + (f + n) / (n - f) / 2 * w, w
        return [row.T / s for row, s in zip(rows, [*scale, 1])]

    half = long([width / 2, height / 2, 0.5]) / scale
    if products:
        return lambda u, v: rows_of(*solved(u, v)), half
    control, turned = long(patches[which]), long(twists[which] if twists.size else np.zeros((0, 3)))
    w = control[..., 3:] if control.shape[-1] == 4 else np.ones_like(control[..., :1])
    rows = list(zip(rows_of(control[..., :3], w), rows_of(turned, np.zeros_like(turned[..., :1]))))
    return lambda u, v: at(rows, u, v), half


def turning(u, v, slots):
    def part(s, t):
        return (s - t) / np.where(s + t == 0, 1, s + t) / 2

    a, b = 1 - u, 1 - v
    corners = (u, v), (v, a), (a, b), (b, u)
    found = [9 * s * t * ((1 - s) * (1 - t)) ** 2 * part(s, t) for s, t in corners]
    p, q = a * b, a * v
    return [*found, 12 * p * p * q * u * part(u, q), 12 * q * q * p * u * part(p, u)][:slots]


def at(rows, u, v):
    along = lambda t, d: np.stack([comb(d, j) * t**j * (1 - t) ** (d - j) for j in range(d + 1)])
    found = [np.sum(along(u, r.shape[0] - 1) * (r @ along(v, r.shape[1] - 1)), axis=0) for r, _ in rows]
    return [x + sum(d * b for d, b in zip(t, turning(u, v, len(t)))) for x, (_, t) in zip(found, rows)]


def solved(u, v):
    """det Q times scale Q^-1 h + offset, and det Q, from q alone."""
    net, scale, offset = long(products[0]), long(products[1]), long(products[2])
    a, b, c, d, e, f, *h = at([(part, ()) for part in np.moveaxis(net.reshape(4, 4, 9), 2, 0)], u, v)
    one, two, three = (np.stack(row, axis=-1) for row in ((a, b, c), (b, d, e), (c, e, f)))
    adjugate = np.cross(two, three), np.cross(three, one), np.cross(one, two)
    w = np.sum(one * adjugate[0], axis=-1)[..., None]
    return scale * sum(x[..., None] * row for x, row in zip(h, adjugate)) + offset * w, w


def ratio(corners, shares):
    """The largest of triangles (t, 3, 2) at places (s, 3) in them."""
    rows_at, half = screen()
    corners, shares = np.asarray(corners, np.longdouble), np.asarray(shares, np.longdouble)
    u, v = np.einsum("sk,tkc->cts", shares, corners)
    ends = [r.reshape(-1, 3) for r in rows_at(*corners.reshape(-1, 2).T)]
    drawn = [(r @ shares.T).ravel() for r in ends]
    exact = rows_at(u.ravel(), v.ravel())
    seen = (drawn[3] > 0) & np.all([np.abs(r) <= h * drawn[3] for r, h in zip(drawn, half)], axis=0)
    kept = [[r[seen] for r in side] for side in (exact, drawn)]
    if not seen.any():
        return 0.0
    if np.any(kept[0][3] <= 0):
        return float("inf")
    count = 2 if depth_tolerance is None else 3
    return float(max(np.max(np.abs(a / kept[0][3] - b / kept[1][3])) for a, b in zip(kept[0][:count], kept[1])))
'''

_NORMALS = '''def shaded():
    if not tangents:
        return given()[[which]]
    return Shaded(given(), *(np.array(own, "{dtype}") for own in tangents))[[which]]


def ratio(corners, shares):
    """The largest of triangles (t, 3, 2) at places (s, 3) in them."""
    look = Look(eye, target, up, extent, near, far, perspective, width, height)
    own = Normals.of(shaded(), look, normal_tolerance, np.ones(1, bool), hidden={hidden})
    corners, shares = np.asarray(corners, np.longdouble), np.asarray(shares, np.longdouble)
    ends = own.at(*corners.reshape(1, -1, 2).transpose(2, 0, 1)).reshape(-1, 3, 7)
    u, v = (shares @ corners).reshape(1, -1, 2).transpose(2, 0, 1)
    drawn = (shares @ ends).reshape(1, -1, 7)
    return float(np.max(own.ratio(own.at(u, v).transpose(2, 0, 1), drawn.transpose(2, 0, 1))))
'''
_IMPORT_NORMALS = """
from slefejax.experiments.attack.judge.normals import Normals
from slefejax.experiments.attack.judge.screen import Look
from slefejax.experiments.attack.families.shaded import Shaded
"""

_CLAIMED_UNIFORM = """claimed_factor = {factor}
more = {more}  # cells a side than ceil(factor)
"""
_UNIFORM = """
def worst(claimed):
    factor = claimed_factor if claimed else float(predicted().factor[which])
    n = int(np.ceil(factor)) + more if factor > 0 else 5
    print(f"factor {factor!r}, {n} x {n} cells")
    i, j = (x.reshape(-1, 1) for x in np.divmod(np.arange(n * n), n))
    shapes = [[0, 0], [1, 0], [1, 1]], [[0, 0], [0, 1], [1, 1]], [[0, 0], [1, 0], [0, 1]], [[1, 1], [0, 1], [1, 0]]
    corners = [(np.stack([i, j], axis=2) + np.array(shape)) / n for shape in shapes]
    lattice = [(a, b, 12 - a - b) for a in range(13) for b in range(13 - a)]
    return max(ratio(np.concatenate(corners), np.array(lattice) / 12), ratio([triangle], [share]) if claimed else 0)
"""
_CLAIMED_DRAWN = """claimed_inner, claimed_edges = {levels}  # of that patch
edge_numbers = np.array({numbers})
"""
_DRAWN = """
def worst(claimed):
    if not claimed:
        found = predicted()
        inner, edges = found.inner[which].tolist(), found.edges[which].tolist()
        print(f"inner {inner}, edges {edges}")
        if (inner, edges) != (claimed_inner, claimed_edges):
            print("these are other levels than those that were claimed, of which the triangle is one")
            return 0.0
    return ratio([triangle], [share])
"""


def script(found: Row) -> str:
    """The text of the script for an offender of a batch (``attack_batch``), with its family, setting and seed."""
    setting = SETTINGS[found["setting"]]
    patches = np.array(found["patches"])
    drawn = "edge_numbers" in found
    which = found.get("which", 0)
    factor = "float('nan')" if found["factor"] is None else repr(found["factor"])
    options = {**setting.options}
    claim = f"factor {factor}"
    if drawn:
        own = found["inner"][which], found["edges"][which]
        claimed = _CLAIMED_DRAWN.format(levels=own, numbers=found["edge_numbers"])
        claim += f", levels {own[0]} and {own[1]}"
    else:
        more = found["cut"] - int(np.ceil(found["factor"] or 0.0)) if found["factor"] else 0
        claimed = _CLAIMED_UNIFORM.format(factor=factor, more=more)
    products = found.get("products")
    if products is not None:
        net, scale, offset = (products[name][which] for name in ("gaussians", "scale", "offset"))
        products = np.ravel(net).tolist(), scale, offset
    text = "".join(f", {name}={value!r}" for name, value in options.items())
    normals, dtype = setting.normals, np.dtype(setting.dtype).name
    return _SCRIPT.format(
        title=f"{found['family']}, {found['setting']}, seed {found['seed']}: {found['ratio']:.9g} times the tolerance.",
        claim=claim,
        look=tuple(tuple(x) if isinstance(x, list) else x for x in found["look"]),
        tolerances=tuple(found["tolerances"]),
        patches=pformat(patches.ravel().tolist(), compact=True, width=118),
        shape=patches.shape,
        twists=found.get("twists", []),
        tangents=found.get("tangents", []),
        products=pformat(products, compact=True, width=118),
        which=which,
        triangle=found["triangle"],
        share=found["share"],
        claimed=claimed,
        double=setting.double,
        dtype=dtype,
        imports=_IMPORT_NORMALS if normals else "",
        judged_by=f"The judge is {'that of slefejax attack' if normals else 'below'}, in long double.",
        measure=_NORMALS.format(dtype=dtype, hidden=setting.hidden) if normals else _POSITIONS,
        options=text + (", edge_numbers=edge_numbers" if drawn else ""),
        judge=_DRAWN if drawn else _UNIFORM,
    )
