"""Cameras of other renderers' frames: told by headers, by files of their own, or by the positions that pixels show."""
