"""For users of Mitsuba: its denoiser's call with this package's filters. Importing this does not import Mitsuba."""

import lazy_loader

# As in the package itself: the names are in __init__.pyi, which `attach_stub` reads.
__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
