"""Rendering, the only importer of Mitsuba."""
