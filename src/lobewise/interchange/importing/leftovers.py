"""Name the noisy images of a file that denoising leaves as they are: other pictures, and passes of the same picture."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Iterator, Sequence
from contextlib import suppress

import numpy as np

from lobewise.errors import FileError
from lobewise.guides.squares import compute_square_maximum
from lobewise.interchange.channels import COLOR, Pass
from lobewise.interchange.imported import ImageReader, Imported
from lobewise.interchange.lighting import is_grainy, is_smooth, name_pass
from lobewise.interchange.mapping import ChannelMap, Found, Key
from lobewise.interchange.preset import load_presets
from lobewise.interchange.selections import Selection
from lobewise.interchange.siblings import FIRST_SIBLING_INDEX
from lobewise.io.exr.container import crop_part, show_name
from lobewise.io.exr.header import read_replaced
from lobewise.io.exr.layout import join_planes
from lobewise.io.exr.pixels import decode_part
from lobewise.records.frame import FloatArray
from lobewise.records.images import is_band

MAX_NAMES = 4
"""Most names of one kind in the sentence."""
MAX_COPY_DIFFERENCE = 1e-2
"""Largest mean difference of a copy of the picture, as a share of the picture's mean. Copies differ by rounding."""
MIN_FRACTION_SHARE = 0.002
"""Share of the pixels that are fractions of opacity among others, above which an image of opacity is denoised."""
FRACTIONS = (0.01, 0.99)
"""Alpha between these values is a share of the samples, and as noisy as the picture."""
ALSO = "--also NAME denoises one"
"""How to denoise a pass that is none of the picture."""
MAX_JUDGED_ROWS = 128
"""Most rows in which further passes are searched for noise; an image has dozens of such passes."""
FOR_DENOISERS = ("denois", "variance", "_var", "_mse", "m2_")
"""What is in the names of passes for denoisers, such as the variance of another pass. They need not be clean."""
OWN_PARTS = ("direct", "indirect")
"""Light of files in lobewise's own channel names that no filter writes."""


def describe_left_noisy(
    imported: Imported, read: ImageReader, denoised: Collection[Selection], *, alpha_stays: bool = False
) -> tuple[str, ...]:
    """Return a sentence that names the noisy images that stay in the file; nothing if none stay.

    Parameters
    ----------
    imported : Imported
        What is denoised of a file of another renderer.
    read : ImageReader
        Reads images of the file.
    denoised : collection of Selection
        The views and view layers of the file that are denoised.
    alpha_stays : bool
        Whether there is a noisy opacity that is not denoised.
    """
    channels = imported.map
    unused = list(_list_unused(imported, channels))
    exact = _keep_grainy(imported, _list_exact(imported))
    others = _keep_grainy(imported, _list_others(imported, channels))
    views, layers = ({getattr(each, what): None for each in channels.selections} for what in ("view", "layer"))
    words = [
        *list_names("view", [each for each in views if each not in {one.view for one in denoised}]),
        *list_names("view layer", [each for each in layers if each not in {one.layer for one in denoised}]),
        *list_names("light group", [name for name, _ in _pick_groups(channels, unused)]),
        *list_names("pass of light", [*_list_light(channels, unused, read), *exact], many="passes of light"),
        *_name_pictures(channels, [one for one in unused if _is_picture(channels, one.source)], read),
        *(["alpha"] if alpha_stays else []),
        *_count_bands(imported, channels),
        *(f"{names} ({ALSO})" for names in list_names("pass", others, many="passes")),
    ]
    return (f"Left noisy: {', '.join(words)}.",) if words else ()


def list_names(what: str, names: Iterable[str], many: str = "") -> list[str]:
    """Return the names of things of one kind in a list of at most one text: ``views 'left', 'right'``."""
    names = list(dict.fromkeys(names))
    if not names:
        return []
    names_shown = ", ".join(repr(show_name(name)) for name in names[:MAX_NAMES])
    left_out = len(names) - MAX_NAMES
    noun = what if len(names) == 1 else many or f"{what}s"
    return [f"{noun} {names_shown}{f' and {left_out} more' if left_out > 0 else ''}"]


def _list_unused(imported: Imported, channels: ChannelMap, *, with_planes: bool = False) -> Iterator[Found]:
    """Yield the images that no result is written to, that are no guides, and not denoised before.

    These are images of three channels; ``with_planes`` adds those of a single one.
    """
    before = read_replaced(imported.container) or {}
    # A noisy image whose result goes into another pass stays on purpose.
    used = [*(one.target for one in imported.outputs.values()), *channels.roles.values()]
    used += [one for layer in channels.layers for one in (layer.albedo,) if one]
    taken = {(one.source.part.index, name) for one in used for name in one.channels}
    guides = [rule.source for role, rules in channels.preset.roles.items() if role != "color" for rule in rules]
    for one in channels.beside:
        names = one.pick(COLOR[:1]) or (tuple(one.channels.values()) if with_planes and len(one.channels) == 1 else ())
        index = one.part.index
        if not names or index >= FIRST_SIBLING_INDEX or any(source and one.matches(source) for source in guides):
            continue
        if not any((index, name) in taken or name in before.get(index, ()) for name in names):
            yield Found(one, names)


def _is_light(channels: ChannelMap, one: Pass) -> bool:
    """Return whether a pass has a name of light in the preset; in that of no renderer, of light in any preset."""
    preset = channels.preset
    presets = load_presets().values() if preset.name == "generic" else (preset,)
    rules = [rule for each in presets for rule in each.layers if rule.lobe != "exact"]
    return any(one.matches(name) for rule in rules for name in rule.light)


def list_light_groups(imported: Imported) -> list[tuple[str, Found]]:
    """Return the light groups of a file that no result is written to: the name of each light, and the image."""
    channels = imported.map
    # Light groups are parts of the picture, not of another image that the user chose.
    if not _is_picture(channels, channels.roles["color"].source):
        return []
    return _pick_groups(channels, list(_list_unused(imported, channels)))


def list_further(imported: Imported) -> list[Found]:
    """Return the further noisy passes of a file that its preset names."""
    channels = imported.map
    patterns = channels.preset.also
    unused = _list_unused(imported, channels) if patterns else ()
    return [found for found in unused if any(found.source.matches(pattern) for pattern in patterns)]


def _list_exact(imported: Imported) -> list[Found]:
    """Return the passes of light that no surface scattered. They stay: a fire's light has noise, that of lamps none."""
    return [imported.outputs[name].target for name in imported.frame.unscattered if name in imported.outputs]


def _list_others(imported: Imported, channels: ChannelMap) -> list[Found]:
    """Return further images of a file that are neither light of the picture nor made for denoising."""
    presets = load_presets().values() if channels.preset.name == "generic" else (channels.preset,)
    known = [rule.albedo for each in presets for rule in each.layers if rule.albedo]
    known += [pattern for each in presets for pattern in (*each.light_groups, *(f"{one}*" for one in each.cryptomatte))]
    return [
        found
        for found in _list_unused(imported, channels, with_planes=True)
        for one in (found.source,)
        if not _is_picture(channels, one) and not _is_light(channels, one) and not any(map(one.matches, known))
        if not any(word in one.path.lower() for word in FOR_DENOISERS) and not is_band(found.channels[0])
    ]


def _keep_grainy(imported: Imported, listed: Sequence[Found]) -> list[str]:
    """Return the names of the images that have noise in the middle rows of the file."""
    container, grainy = imported.container, []
    for part in {found.source.part.index: found.source.part for found in listed}.values():
        if not all(channel.is_whole for channel in part.channels):
            continue
        own = [found for found in listed if found.source.part.index == part.index]
        rows = part.rows_per_chunk
        count = rows * -(-MAX_JUDGED_ROWS // rows)
        first = max((part.data_window.height - count) // 2, 0) // rows * rows
        strip = crop_part(part, first, min(first + count, part.data_window.height))
        with suppress(FileError):
            pixels = decode_part(container, strip, {name for found in own for name in found.channels})
            grainy += [
                name_pass(found.source.path)
                for found in own
                if is_grainy(join_planes([pixels[name] for name in found.channels]))
            ]
    return grainy


def _pick_groups(channels: ChannelMap, unused: Sequence[Found]) -> list[tuple[str, Found]]:
    groups: dict[Key, tuple[str, Found]] = {}
    for pattern in channels.preset.light_groups:
        for found in unused:
            one = found.source
            if one.matches(pattern) and not _is_light(channels, one) and not _is_picture(channels, one):
                last, beginning = name_pass(one.path), pattern.rstrip("*")
                name = last if "*" in beginning else last[len(beginning) :].lstrip("_") or last
                groups.setdefault(found.key, (name, found))
    return list(groups.values())


def _list_light(channels: ChannelMap, unused: Iterable[Found], read: ImageReader) -> list[str]:
    light = [one for one in unused if _is_light(channels, one.source)]
    noisy = [name_pass(one.source.path) for one in light if not is_smooth(_take_finite(read, one))]
    return [*noisy, *(role for role in OWN_PARTS if role in channels.roles)]


def _is_picture(channels: ChannelMap, one: Pass) -> bool:
    """Return whether a pass has a name of the picture; a pass without a path has."""
    return not one.path or any(
        rule.source and one.matches(rule.source) for rule in channels.preset.roles.get("color", ())
    )


def _name_pictures(channels: ChannelMap, alike: Sequence[Found], read: ImageReader) -> list[str]:
    """Return images with names of the picture: the copies of it, or all of them if the user chose another image.

    Images of other view layers are named with their layers.
    """
    alike = [one for one in alike if one.source.path.rpartition(".")[0] == channels.prefix.removesuffix(".")]
    if not alike:
        return []
    if not _is_picture(channels, channels.roles["color"].source):
        return list_names("picture", [one.source.path for one in alike])
    picture = _take_finite(read, channels.roles["color"])
    most = MAX_COPY_DIFFERENCE * float(np.abs(picture).mean())
    copies = [one.source.path for one in alike if float(np.abs(_take_finite(read, one) - picture).mean()) <= most]
    return list_names("copy of the picture", copies, many="copies of the picture")


def _take_finite(read: ImageReader, found: Found) -> FloatArray:
    return np.nan_to_num(read(found), nan=0.0, posinf=0.0, neginf=0.0)


def take_noisy_alpha(channels: ChannelMap, read: ImageReader) -> tuple[Found, FloatArray] | None:
    """Return the channel of an opacity that is a fraction in whole areas, and its values; None where there is none.

    At silhouettes opacity is a fraction as well, and needs no filter.
    """
    source = channels.target.source
    if "a" not in source.channels:
        return None
    found, (low, high) = Found(source, (source.channels["a"],)), FRACTIONS
    alpha = _take_finite(read, found)
    plain = ((alpha <= low) | (alpha >= high)).astype(np.float32)
    inside = compute_square_maximum(plain, 1) == 0.0
    return (found, alpha) if np.mean(inside) > MIN_FRACTION_SHARE else None


def _count_bands(imported: Imported, channels: ChannelMap) -> list[str]:
    denoised = {name for one in imported.outputs.values() for name in one.target.channels}
    count = sum(is_band(name) for one in channels.beside for name in {*one.channels.values()} - denoised)
    return [f"{count} spectral band{'s' if count > 1 else ''} (--also '*nm' takes all)"] if count else []
