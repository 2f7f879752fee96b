"""Mitsuba and Dr.Jit without types.

Their stubs describe one variant, know no broadcasting and miss overloads, and are absent where the packages are; so
that the checker says the same everywhere, the rest of this room takes the two modules from here. Importing this raises
`MissingDependencyError` where they are not installed.
"""

from __future__ import annotations

from typing import Any

from lobewise.errors import MissingDependencyError

try:
    import drjit
    import mitsuba
except ImportError as error:
    raise MissingDependencyError(
        "rendering",
        expected="the packages mitsuba and drjit",
        got=f"no module {error.name!r}",
        action="pip install 'lobewise[mitsuba]'",
    ) from error

dr: Any = drjit
mi: Any = mitsuba
