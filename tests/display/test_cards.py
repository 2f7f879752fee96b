"""Cards of notebooks: what they show, that they stand alone, and that no text of a file becomes markup."""

import base64
import html
import io
import pickle
import re
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from PIL import Image

import lobewise
from lobewise.display import cards
from lobewise.display.cards import MAX_WIDTH_PIXELS, make_card
from lobewise.display.tones import choose_exposure, map_tones
from tests.streaming.frames import make_scene

VOID = {"img", "input"}


class Balance(HTMLParser):
    """Fails on a tag that is not closed where it should be."""

    def __init__(self) -> None:
        super().__init__()
        self.open: list[str] = []

    def handle_starttag(self, tag: str, attrs: object) -> None:
        if tag not in VOID:
            self.open.append(tag)

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag


def read_pictures(card: str) -> list[NDArray[np.uint8]]:
    """Return the pictures of a card, in order."""
    found = re.findall(r'src="data:image/png;base64,([^"]+)"', card)
    return [np.asarray(Image.open(io.BytesIO(base64.b64decode(each)))) for each in found]


def require_alone(card: str) -> None:
    """Fail unless a card is whole HTML that names no other file."""
    parser = Balance()
    parser.feed(card)
    assert not parser.open
    assert not re.search(r'(src|href)="(?!data:)', card)


def test_frame_shows_its_picture_and_what_it_holds() -> None:
    frame = make_scene((24, 36))
    card = frame._repr_html_()
    require_alone(card)
    (picture,) = read_pictures(card)
    np.testing.assert_array_equal(picture, map_tones(frame.radiance.color, choose_exposure(frame.radiance.color)))
    assert "36x24" in card
    assert all(name in card for name in frame.gbuffer.names)


def test_result_shows_both_pictures_with_one_exposure() -> None:
    frame = make_scene((24, 36))
    result = lobewise.denoise(frame, quality="fast", radius=2)
    card = result._repr_html_()
    require_alone(card)
    clean, noisy = read_pictures(card)
    exposure = choose_exposure(result.image)
    np.testing.assert_array_equal(clean, map_tones(result.image, exposure))
    np.testing.assert_array_equal(noisy, map_tones(frame.radiance.color, exposure))
    assert 'type="range"' in card
    assert html.escape(result.method) in card


def test_result_does_not_keep_the_noisy_frame() -> None:
    result = lobewise.denoise(make_scene((24, 36)), quality="fast", radius=2)
    assert result.find_noisy() is None
    assert len(read_pictures(result._repr_html_())) == 1
    again = pickle.loads(pickle.dumps(result))
    np.testing.assert_array_equal(again.image, result.image)
    assert again.find_noisy is None


@pytest.mark.parametrize("method", ["temporal", "window"])
def test_other_recipes_know_their_noisy_frame(method: str) -> None:
    frames = [make_scene((24, 36)) for _ in range(3)]
    if method == "temporal":
        result = lobewise.TemporalFilter(radius=2).add(frames[1])
    else:
        result = lobewise.WindowFilter(1, quality="fast").denoise(frames, 1)
    assert result.find_noisy() is frames[1].radiance.color


def test_wide_pictures_are_shrunk() -> None:
    image = np.full((10, 4 * MAX_WIDTH_PIXELS, 3), 0.5, np.float32)
    (picture,) = read_pictures(make_card("wide", {"light": image}, []))
    assert picture.shape == (3, MAX_WIDTH_PIXELS, 3)


def test_large_images_are_thinned_before_they_are_painted(monkeypatch: pytest.MonkeyPatch) -> None:
    painted = []
    monkeypatch.setattr(
        cards, "map_tones", lambda image, exposure: painted.append(image.shape) or map_tones(image, 1.0)
    )
    make_card("large", {"light": np.ones((20, 4 * MAX_WIDTH_PIXELS, 3), np.float32)}, [])
    assert painted == [(5, MAX_WIDTH_PIXELS, 3)]


def test_texts_are_escaped(tmp_path: Path) -> None:
    image = np.ones((2, 2, 3), np.float32)
    card = make_card("<script>", {"<b>": image, '"a"': image}, [("<i>", "</table>")])
    require_alone(card)
    assert not re.search(r"<script>|<b>|<i>|</table>.*</table>", card)


def test_image_without_finite_pixels_has_facts_alone() -> None:
    card = make_card("empty", {"light": np.full((2, 2, 3), np.nan, np.float32)}, [("a", "b")])
    require_alone(card)
    assert read_pictures(card) == []
    assert "<td" in card
