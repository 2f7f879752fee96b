"""Steps that keep pixels without samples out of all averages: those of a pattern, and the gutters of a bake."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from lobewise.interchange.channels import COLOR
from lobewise.interchange.checks.finding import Finding
from lobewise.interchange.checks.unsampled import NOT_RENDERED, fill_gutters, mark_gutters, mark_pattern, repeat
from lobewise.interchange.importing.draft import Draft, Outcome
from lobewise.interchange.mapping import Found
from lobewise.records.frame import Radiance

NOISY = ("color", "diffuse", "specular")
"""Roles of light that filters fill."""
MAX_FILLED_SHARE = 0.6
"""Largest share of the pixels that filters fill: of three in four they lost most of the layers' light."""


def mark_left_out(draft: Draft) -> Outcome:
    """Fill every image where nothing was rendered, as on a checkerboard: noisy light becomes NaN, which filters fill.

    Guides and light without noise, which no filter fills, take the values of neighbours; so does noisy light where
    most pixels were left out. Images that are whole stay.
    """
    channels, read = draft.channels, draft.read
    left_out = mark_pattern(read(channels.roles["color"]))
    if left_out is None:
        return Outcome(draft)
    exact = [found for role, found in channels.roles.items() if role not in NOISY]
    exact += [one for layer in channels.layers if layer.rule.lobe == "exact" for one in layer.light]
    exact += [layer.albedo for layer in channels.layers if layer.albedo is not None]
    known = {found.key for found in exact}
    beside = [(one, one.pick(COLOR)) for one in channels.beside if one.part.data_window == draft.image_part.data_window]
    noisy = [Found(one, names) for one, names in beside if names is not None]
    noisy += [found for role, found in channels.roles.items() if role in NOISY]
    noisy += [one for layer in channels.layers for one in layer.light]
    is_dense = left_out.mean() <= MAX_FILLED_SHARE
    filled = {}
    for found in (*exact, *(one for one in noisy if one.key not in known)):
        image = read(found)
        if image[left_out].any():
            continue
        where = left_out if image.ndim == 2 else left_out[..., None]
        marks = is_dense and found.key not in known
        filled[found.key] = np.where(where, np.float32(np.nan), image) if marks else repeat(image, ~left_out)
    note = (
        f"{100.0 * left_out.mean():.2g} % of the pixels hold no light, in a pattern that repeats, like a checkerboard: "
        "they were not rendered, and are filled from their neighbours."
    )
    pattern = Finding(NOT_RENDERED, note, mended=True)
    return Outcome(replace(draft, read=read.with_images(filled)), [pattern])


def continue_into_gutters(draft: Draft) -> Outcome:
    """Continue the light of a bake, which has no guides, into its gutters. What is written there is 0."""
    frame, target = draft.frame, draft.outputs.get("color")
    assert frame is not None
    chosen = draft.channels.roles["color"].source.pick(("a",))
    if target is None or chosen is None or frame.gbuffer.names or frame.layers or frame.radiance.parts is not None:
        return Outcome(draft)
    color = frame.radiance.color
    alpha = draft.read(Found(draft.channels.roles["color"].source, chosen))
    gutters = mark_gutters(color, alpha)
    if gutters is None:
        return Outcome(draft)
    filled = frame.with_changes(radiance=Radiance(fill_gutters(color, ~gutters)))
    outputs = {**draft.outputs, "color": replace(target, divided_by=alpha[..., None])}
    note = (
        f"{100.0 * gutters.mean():.2g} % of the pixels are gutters, without light and alpha: they count in no average, "
        "and stay black."
    )
    return Outcome(replace(draft, frame=filled, outputs=outputs), [Finding("gutters of a bake", note, mended=True)])
