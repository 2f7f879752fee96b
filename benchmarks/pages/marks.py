"""Marked places of Markdown pages. Programs fill these places; people write everything around them.

A place begins with `<!-- figures:NAME -->` and ends with `<!-- figures:end -->`.
"""

import re
from collections.abc import Mapping

PLACE = re.compile(r"<!-- figures:(?!end)([\w-]+) -->\n.*?<!-- figures:end -->", flags=re.S)


def fill_places(page: str, figures: Mapping[str, str]) -> str:
    """Return a page whose marked places hold the given Markdown, by the name of the place.

    Raises
    ------
    ValueError
        If the page has a place without figures, or if figures have no place in the page.
    """
    names = PLACE.findall(page)
    if sorted(names) != sorted(figures):
        raise ValueError(f"the page has the places {sorted(names)}, the figures are for {sorted(figures)}")
    return PLACE.sub(
        lambda place: f"<!-- figures:{place[1]} -->\n\n{figures[place[1]].strip()}\n\n<!-- figures:end -->", page
    )
