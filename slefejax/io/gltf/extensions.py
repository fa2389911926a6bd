"""What extensions of glTF do to shapes: followed, of no matter to them, or told."""

from __future__ import annotations

from typing import Any

# Read here: all that they do to shapes.
_FOLLOWED = ("KHR_mesh_quantization", "EXT_mesh_gpu_instancing", "KHR_node_visibility", "KHR_animation_pointer")
# Beginnings of the names of those that only change colours, lights, cameras, sounds or what is said about a model.
_HARMLESS = (
    *("KHR_materials", "KHR_texture", "KHR_lights", "KHR_xmp", "KHR_techniques_webgl", "KHR_environment_map"),
    *("KHR_audio", "KHR_node_selectability", "KHR_node_hoverability"),
    *("EXT_texture", "EXT_lights", "EXT_mesh_manifold", "EXT_mesh_features", "EXT_instance_features"),
    *("EXT_structural_metadata", "CESIUM_primitive_outline", "MSFT_texture", "MSFT_packing", "ADOBE_materials"),
    "VRMC_materials",
)
# Compressed shapes beside which a file may have plain ones: those are read, or missed where they are asked for.
DRACO = "KHR_draco_mesh_compression"
MESHOPT = ("EXT_meshopt_compression", "KHR_meshopt_compression")


def hides_shapes(name: str) -> bool:
    """Whether a file that requires this extension cannot be read."""
    return name not in _FOLLOWED and not name.startswith(_HARMLESS)


def extension_notes(used: Any) -> list[str]:
    """A sentence on each of the extensions that a file uses and that may change shapes without being followed."""
    names = [str(name)[:60] for name in used] if isinstance(used, list) else []
    beside = (DRACO, *MESHOPT)
    return [
        f"the extension {name} is not known here: whatever it does to shapes was left out"
        for name in dict.fromkeys(names)
        if hides_shapes(name) and name not in beside
    ]


def extension_of(owner: Any, name: str) -> dict[str, Any] | None:
    """What an object of the file says in an extension, None if nothing."""
    found = (owner.get("extensions") or {}).get(name)
    return found if isinstance(found, dict) else None
