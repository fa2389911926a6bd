"""A scene as it is drawn, in many looks (docs/render.md)."""
