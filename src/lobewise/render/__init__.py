"""Rendering with Mitsuba, which no other room imports. Mitsuba is imported at the first use of a name."""

import lazy_loader

# `attach_stub` reads the names from __init__.pyi.
__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
