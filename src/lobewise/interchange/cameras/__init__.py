"""Cameras of other renderers' frames: read from headers or camera files, or fitted to the positions of pixels."""
