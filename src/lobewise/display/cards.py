"""Cards of frames and results for notebooks: a picture, or two with a movable edge between them, and short facts."""

from __future__ import annotations

import base64
import html
import io
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lobewise.display.tones import choose_exposure, map_tones
from lobewise.errors import InputError

MAX_WIDTH_PIXELS = 800
"""Wider pictures are shrunk for a card: a notebook keeps every picture in its file."""
MIN_WIDTH_PIXELS = 360
"""Narrower pictures are enlarged."""

_IMAGE = "width:100%;display:block;margin:0"
_LABEL = "position:absolute;bottom:8px;padding:2px 8px;color:#fff;background:rgba(0,0,0,.55);border-radius:4px"


def make_card(title: str, pictures: Mapping[str, NDArray[np.float32]], facts: Sequence[tuple[str, str]]) -> str:
    """Return an HTML card.

    Parameters
    ----------
    title : str
    pictures : mapping of str to (height, width, 3)
        Linear radiance by label, one or two of one size. Two lie on each other, with a slider that moves the edge
        between them. The exposure follows the last.
    facts : sequence of (str, str)
        Name and value, a row each.

    Returns
    -------
    str
        HTML that needs no other file. All texts are escaped.
    """
    tags = _encode_all({name: thin_out(image) for name, image in pictures.items()})
    shown = _lay_over(*tags.items()) if len(tags) == 2 else "".join(tags.values())
    rows = "".join(
        f'<tr><th style="text-align:left;vertical-align:top;padding:1px 12px 1px 0;white-space:nowrap">'
        f'{html.escape(name)}</th><td style="text-align:left">{html.escape(value)}</td></tr>'
        for name, value in facts
    )
    width = max((min(image.shape[1], MAX_WIDTH_PIXELS) for image in pictures.values()), default=0)
    width = max(width, MIN_WIDTH_PIXELS)
    return (
        f'<div><strong>{html.escape(title)}</strong><div style="max-width:{width}px">{shown}</div>'
        f'<table style="margin:6px 0;border:0">{rows}</table></div>'
    )


def _encode_all(pictures: Mapping[str, NDArray[np.float32]]) -> dict[str, str]:
    """Return an image's address for every picture; nothing where no pixel is finite."""
    if not pictures:
        return {}
    try:
        exposure = choose_exposure(list(pictures.values())[-1])
    except InputError:
        return {}
    return {
        name: f'<img alt="{html.escape(name)}" style="{_IMAGE}" src="{encode_bytes(map_tones(image, exposure))}">'
        for name, image in pictures.items()
    }


def _lay_over(first: tuple[str, str], second: tuple[str, str]) -> str:
    """Return two pictures on each other, the first at the left of a movable edge."""
    move = "this.parentNode.style.setProperty('--at',this.value+'%')"
    over = first[1].replace(
        _IMAGE, f"{_IMAGE};position:absolute;inset:0;clip-path:inset(0 calc(100% - var(--at)) 0 0)", 1
    )
    return (
        f'<div style="position:relative;--at:50%;line-height:0;overflow:hidden">{second[1]}{over}'
        '<div style="position:absolute;top:0;bottom:0;left:var(--at);width:2px;background:#fff"></div>'
        f'<span style="{_LABEL};left:8px;line-height:1.3">{html.escape(first[0])}</span>'
        f'<span style="{_LABEL};right:8px;line-height:1.3">{html.escape(second[0])}</span>'
        f'<input type="range" min="0" max="100" value="50" oninput="{move}" aria-label="Edge between the pictures" '
        'style="position:absolute;inset:0;width:100%;height:100%;margin:0;opacity:0;cursor:ew-resize"></div>'
    )


def thin_out(image: NDArray[Any]) -> NDArray[Any]:
    """Return every n-th row and column of a large image, at least `MAX_WIDTH_PIXELS` columns: painting takes memory."""
    step = max(image.shape[1] // MAX_WIDTH_PIXELS, 1)
    return image[::step, ::step]


def encode_bytes(colors: NDArray[np.uint8]) -> str:
    """Return the data URL of a PNG of sRGB colors, (height, width, 3), shrunk to at most `MAX_WIDTH_PIXELS` columns."""
    from PIL import Image

    picture = Image.fromarray(colors)
    if picture.width > MAX_WIDTH_PIXELS:
        height = max(1, round(picture.height * MAX_WIDTH_PIXELS / picture.width))
        picture = picture.resize((MAX_WIDTH_PIXELS, height), Image.Resampling.BOX)
    out = io.BytesIO()
    picture.save(out, "PNG", optimize=True)
    return "data:image/png;base64," + base64.b64encode(out.getvalue()).decode("ascii")
