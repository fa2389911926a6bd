"""A small whole file of every kind that can be read."""

from __future__ import annotations

import json
import struct
from pathlib import Path
from typing import Any

import numpy as np

from slefejax import load, save
from slefejax.model.mesh import Mesh
from tests.gltf_files import figure
from tests.test_io import BV, OBJ
from tests.test_makehuman import folder
from tests.test_pair import minimal, put
from tests.test_ply import STRIPS, ply
from tests.test_rhino import block, quad
from tests.test_usd import USD, nurbs_usd
from tests.test_usd_skel import ARM

TAGS = "t crease 2/1/0 0 1 2.5\nt corner 1/1/0 2 3\nvt 0 0\n"


def write_seeds(place: Path) -> dict[str, str]:
    """A folder a kind; returns for each the name of what is to be loaded in it."""
    found = {
        "obj": "a.obj",
        "bv": "a.bv",
        "bpt": "a.bpt",
        "ply": "a.ply",
        "ply-binary": "a.ply",
        "ply-strips": "a.ply",
        "gltf": "a.gltf",
        "glb": "a.glb",
        "pair": "quad.json",
        "makehuman": ".",
        "usda": "a.usda",
        "usda-nurbs": "a.usda",
        "usda-skel": "a.usda",
        "usdc": "a.usdc",
        "3dm": "a.3dm",
        "3dm-blocks": "a.3dm",
    }
    for kind in found:
        (place / kind).mkdir(parents=True)
    (place / "obj" / "a.obj").write_text(OBJ + TAGS)
    (place / "bv" / "a.bv").write_text(BV)
    save(load("steep-patch"), place / "bpt" / "a.bpt")
    cube = Mesh.of(
        np.array([[x, y, z] for x in (0.0, 1.0) for y in (0.0, 1.0) for z in (0.0, 1.0)]),
        [[0, 1, 3, 2], [4, 6, 7, 5], [0, 4, 5, 1], [2, 3, 7, 6], [0, 2, 6, 4], [1, 5, 7, 3]],
    )
    (place / "ply" / "a.ply").write_bytes(ply(cube, "ascii", True))
    (place / "ply-binary" / "a.ply").write_bytes(ply(cube, "binary_little_endian", True))
    (place / "ply-strips" / "a.ply").write_text(STRIPS)
    _, content = figure(np.random.default_rng(1))
    text = json.dumps(content).encode()
    (place / "gltf" / "a.gltf").write_bytes(text)
    text += b" " * (-len(text) % 4)
    chunk = struct.pack("<II", len(text), 0x4E4F534A) + text
    (place / "glb" / "a.glb").write_bytes(struct.pack("<4sII", b"glTF", 2, 12 + len(chunk)) + chunk)
    put(place / "pair", *minimal())
    folder(place / "makehuman")
    (place / "usda" / "a.usda").write_text(USD)
    (place / "usda-nurbs" / "a.usda").write_text(nurbs_usd())
    (place / "usda-skel" / "a.usda").write_text(ARM)
    _binary_usd(place / "usda" / "a.usda", place / "usdc" / "a.usdc")
    _rhino(place / "3dm" / "a.3dm")
    _blocks(place / "3dm-blocks" / "a.3dm")
    return found


def _binary_usd(text: Path, binary: Path) -> None:
    from pxr import Usd

    usd: Any = Usd
    usd.Stage.Open(str(text)).Export(str(binary))


def _rhino(path: Path) -> None:
    import rhino3dm

    model = rhino3dm.File3dm()
    model.Objects.AddSphere(rhino3dm.Sphere(rhino3dm.Point3d(0, 0, 0), 1.0))
    model.Objects.AddMesh(quad(rhino3dm))
    model.Write(str(path), 7)


def _blocks(path: Path) -> None:
    """A block in a block, mirrored, and something hidden."""
    import rhino3dm as library

    rhino3dm: Any = library  # whose stubs know little
    model, mirror, hidden = rhino3dm.File3dm(), rhino3dm.Transform(1.0), rhino3dm.ObjectAttributes()
    mirror.M00, hidden.Visible = -1.0, False
    inner = block(rhino3dm, model, "inner", quad(rhino3dm))
    outer = block(rhino3dm, model, "outer", quad(rhino3dm), rhino3dm.InstanceReference(inner, mirror))
    model.Objects.AddInstanceObject(rhino3dm.InstanceReference(outer, rhino3dm.Transform.Translation(3, 0, 0)))
    model.Objects.AddMesh(quad(rhino3dm), hidden)
    model.Write(str(path), 7)
