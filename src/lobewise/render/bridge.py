"""Mitsuba and Dr.Jit without types.

Their stubs describe one variant, know no broadcasting and miss overloads, and are absent where the packages are; so
that the checker says the same everywhere, the rest of this room takes the two modules from here.
"""

from __future__ import annotations

from typing import Any

import drjit
import mitsuba

dr: Any = drjit
mi: Any = mitsuba
