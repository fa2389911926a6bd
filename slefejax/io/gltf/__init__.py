"""glTF files, .gltf and .glb."""
