"""Which options need another one beside them, and which exclude each other: one table for all verbs."""

from __future__ import annotations

from typing import Any

from lobewise.errors import InputError

FILTERS = ("denoise", "upsample")
NEEDS: tuple[tuple[tuple[str, ...], str, str, str], ...] = (
    ((*FILTERS, "render"), "--exposure --display --view --ocio", "--png", "add --png"),
    (FILTERS, "--scene --adaptive-spp --light", "--adaptive", "add --adaptive 5%"),
    (FILTERS, "--adaptive", "--scene", "name the scene"),
    (FILTERS, "--insecure", "--farm", "leave it out"),
    (("upsample",), "--memory", "--temporal", "add --temporal"),
    (("render",), "--camera-path --speed --start --moving-objects", "--frames", "say how many frames"),
    (
        ("inspect",),
        "--quality --with-oidn --similarity --form --radius",
        "--plan",
        "add --plan",
    ),
)
"""Verbs, options, the option that each of them needs, and what to do."""
EXCLUDES: tuple[tuple[tuple[str, ...], str, str], ...] = (
    (FILTERS, "--workers", "--farm"),
    (("upsample",), "--bilinear", "--temporal"),
    (("inspect",), "--plan", "--json --all --attributes --html"),
    (("fit",), "--no-plot", "--plot"),
    (("render",), "--frames", "--aov-only --place"),
    (("render",), "--scale", "--aov-only --reference --png"),
    (("render",), "--aov-only", "--reference --png"),
)
"""Verbs, an option, and options that it excludes."""


def check_pairs(context: Any) -> None:
    """Raise InputError if an option of a verb lacks another, or excludes another; usual values count as none.

    ``context`` is the parsed command line, a ``click.Context``.
    """
    values = context.params
    given = {
        option: None
        for one in context.command.params
        for option in one.opts
        if one.name in values and values[one.name] not in (None, [], (), one.get_default(context))
    }
    for verbs, options, other, action in NEEDS:
        for option in options.split():
            if context.info_name in verbs and option in given and other not in given:
                raise InputError(option, expected=f"{other} beside it", got="none", action=action)
    for verbs, option, others in EXCLUDES:
        for other in others.split():
            if context.info_name in verbs and option in given and other in given:
                expected = f"no {other} beside it"
                raise InputError(option, expected=expected, got="both", action="leave one of them out")
