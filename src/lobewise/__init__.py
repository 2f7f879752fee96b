"""Denoise renders of glossy things by comparing what each pixel reflects."""

import lazy_loader

__version__ = "0.1.0"

# NumPy, Halide and OpenEXR load on first use, so that importing the package and asking the program for help are cheap.
# The names and where they come from are in __init__.pyi, for people, type checkers and this line.
__getattr__, _list_names, __all__ = lazy_loader.attach_stub(__name__, __file__)
__all__ += ["__version__"]


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
