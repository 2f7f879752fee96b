"""Converts the values of options and arguments to their types."""

from __future__ import annotations

from typing import Any

TEXT_AND_NUMBERS = (str, int, float)


class Converter:
    """Keeps the values that have their type, and leaves all others to typer.

    Typer converts each value by pydantic. To import pydantic and to make converters takes 0.15 s, and words and
    defaults have their types.
    """

    def coerce(self, value: Any, param: Any, ctx: Any) -> Any:
        """Return a value of the type of ``param``, an option or argument; ``ctx`` is the command line."""
        described = param.type_descriptor
        if described.parameter_info.parser is None:
            if value is None:
                return () if param.multiple or param.nargs == -1 else None
            if described.annotation in TEXT_AND_NUMBERS and type(value) is described.annotation:
                return value
            if described.annotation == list[str] and all(type(one) is str for one in value):
                return list(value)
        param._runtime_param = None
        return param.get_runtime_param().coerce(value, param=param, ctx=ctx)
