"""The page of a report: its pictures, text and slider; the demonstration."""

import base64
import html
import io
import json
import re
import shutil
import subprocess
import sys
from dataclasses import replace
from html.parser import HTMLParser

import numpy as np
import pytest
from PIL import Image

from lobewise.cli import demo
from lobewise.denoising import denoise
from lobewise.display.tones import choose_exposure, index_errors, make_error_palette, map_tones
from lobewise.errors import FileError, InputError
from lobewise.io.png import encode_png
from lobewise.metrics import evaluate, rel_mse
from lobewise.peers import denoise_oidn
from lobewise.records.frame import Frame
from lobewise.reporting.report import Picture, Report, make_page
from tests.mistakes import refuses


def decode_png(data: bytes) -> tuple[np.ndarray, np.ndarray | None]:
    """Return pixels and palette, as Pillow reads them."""
    with Image.open(io.BytesIO(data)) as picture:
        picture.load()
        palette = picture.getpalette() if picture.mode == "P" else None
        return np.asarray(picture), None if palette is None else np.array(palette, np.uint8).reshape(-1, 3)


class TestPng:
    @pytest.mark.parametrize("size", [(1, 1), (1, 9), (9, 1), (17, 23)])
    def test_pixels_come_back(self, rng, size):
        noise = rng.integers(0, 256, (*size, 3), dtype=np.uint8)
        smooth = np.add.outer(np.arange(size[0]), np.arange(size[1]))[..., None] * np.array([1, 2, 3])
        for image in (noise, smooth.astype(np.uint8), np.zeros_like(noise)):
            np.testing.assert_array_equal(decode_png(encode_png(image))[0], image)

    def test_palette(self, rng):
        palette = rng.integers(0, 256, (256, 3), dtype=np.uint8)
        image = rng.integers(0, 256, (5, 7), dtype=np.uint8)
        pixels, colors = decode_png(encode_png(image, palette))
        np.testing.assert_array_equal(pixels, image)
        np.testing.assert_array_equal(colors, palette)

    @pytest.mark.parametrize("shape", [(3, 4), (3, 4, 4), (0, 4, 3)])
    def test_other_arrays_are_refused(self, shape):
        with refuses(InputError, "picture"):
            encode_png(np.zeros(shape, np.uint8))
        with refuses(InputError, "picture", "float64 of shape (3, 4, 3)"):
            encode_png(np.zeros((3, 4, 3)))  # type: ignore[arg-type]  # the wrong type is what is tested


class TestDisplay:
    def test_srgb_agrees_with_the_standard(self):
        # IEC 61966-2-1: linear 0.21586 is 128/255, 0.0031308 is 10.3/255; both lie in the linear range.
        levels = np.array([0.0, 0.0031308, 0.21586, 0.5])
        image = np.broadcast_to(levels[:, None, None], (4, 1, 3))
        assert map_tones(image, 1.0)[:, 0, 0].tolist() == [0, 10, 128, 188]

    def test_tones_rise_without_a_step_and_reach_white(self):
        ramp = np.linspace(0.0, 4.0, 4001)[:, None, None] * np.ones(3)
        values = map_tones(ramp, 1.0)[:, 0, 0].astype(int)
        assert (np.diff(values) >= 0).all()
        assert np.diff(values)[40:].max() <= 1
        assert values[-1] == 255
        np.testing.assert_array_equal(map_tones(ramp, 0.5), map_tones(ramp * 0.5, 1.0))

    def test_bad_pixels_are_black_or_white(self):
        image = np.array([[[np.nan] * 3, [np.inf] * 3, [-1.0] * 3]])
        assert map_tones(image, 1.0)[0, :, 0].tolist() == [0, 255, 0]

    def test_exposure(self, rng):
        gray = rng.random((50, 50))[..., None] * np.ones(3)
        exposure = choose_exposure(gray)
        assert np.mean(gray[..., 0] * exposure <= 0.8) == pytest.approx(0.98, abs=0.001)
        assert choose_exposure(gray * 7.0) == pytest.approx(exposure / 7.0)
        assert choose_exposure(np.zeros((2, 2, 3))) == 1.0
        with refuses(InputError, "reference"):
            choose_exposure(np.full((2, 2, 3), np.nan))

    def test_error_scale(self):
        assert index_errors([0.0, 0.01, 0.1, 1.0, 50.0]).tolist() == [0, 0, 128, 255, 255]
        palette = make_error_palette().astype(np.float64)
        luminance = palette @ [0.2126, 0.7152, 0.0722]
        assert (np.diff(luminance) > -0.5).all()
        assert luminance[-1] - luminance[0] > 200.0


@pytest.fixture
def report(rng):
    """Return a small report with titles that need escaping."""
    reference = rng.gamma(1.0, 1.0, (70, 80, 3)).astype(np.float32)
    mask = np.zeros((70, 80), dtype=bool)
    mask[20:50, 30:60] = True
    near = reference + np.float32(0.01)
    far = reference * (1.0 + 0.3 * mask[..., None])
    return Report(
        title="A <title> & more",
        subtitle="</script> {{data}}",
        pictures=[
            Picture("far", "far </script><b>", far.astype(np.float32), "note <i>", {"radius": 8, "none": None}, 0.0123),
            Picture("near", "near & dear", near),
        ],
        reference=Picture("reference", "reference", reference),
        baseline="far",
        left="far",
        right="near",
        mask=mask,
        command="lobewise demo --scene '<x>'",
        facts={"machine": "one <core>"},
        remarks=["a <remark>"],
    )


class Tree(HTMLParser):
    """Balance of tags, links, and text by element."""

    def __init__(self, page):
        super().__init__()
        self.open, self.links, self.tags, self.cells = [], [], [], []
        self.feed(page)

    def handle_starttag(self, tag, attrs):
        self.tags.append((tag, dict(attrs)))
        self.links += [value for name, value in attrs if name in ("src", "href", "data", "action")]
        if tag not in ("meta", "input", "br", "link", "img"):
            self.open.append(tag)

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_data(self, data):
        if self.open and self.open[-1] in ("td", "th", "small"):
            self.cells.append(data)


def read_image(page, name):
    return decode_png(
        base64.b64decode(re.search(rf"\.{name}\{{background-image:url\(data:image/png;base64,([^)]*)\)", page)[1])
    )


class TestPage:
    def test_it_is_one_whole_file(self, report):
        page = make_page(report)
        tree = Tree(page)
        assert tree.open == []
        assert tree.links == []
        assert "http" not in page.replace("http-equiv", "")
        assert not re.search(r"@import|url\((?!data:)", page)
        assert not re.search(
            r"\{\{\w+\}\}", page.replace("</script> {{data}}", "").replace(html.escape("</script> {{data}}"), "")
        )

    def test_text_is_escaped(self, report):
        page = make_page(report)
        for text in ("<title> & more", "</script><b>", "note <i>", "<x>", "one <core>", "a <remark>"):
            assert html.escape(text) in page or html.escape(text, quote=False) in page
        assert page.count("</script>") == 2

    def test_pictures_are_inside(self, report):
        page = make_page(report)
        exposure = choose_exposure(report.reference.image)
        for picture in [*report.pictures, report.reference]:
            np.testing.assert_array_equal(read_image(page, f"p-{picture.key}")[0], map_tones(picture.image, exposure))
        a, r = report.pictures[0].image.astype(float), report.reference.image.astype(float)
        error = np.sqrt(((a - r) ** 2 / (r**2 + 0.01)).mean(axis=-1))
        pixels, palette = read_image(page, "e-far")
        np.testing.assert_allclose(pixels.astype(int), index_errors(error).astype(int), atol=1)
        np.testing.assert_array_equal(palette, make_error_palette())
        assert ".e-reference{" not in page

    def test_figures_are_those_of_the_metrics(self, report):
        cells = Tree(make_page(report)).cells
        for mask in (None, report.mask):
            rows = {one.key: evaluate(one.image, report.reference.image, mask) for one in report.pictures}
            for name in ("rel_mse", "mse", "smape", "flip"):
                assert f"{rows['near'][name]:.4f}" in cells
                assert f"\u00d7{rows['near'][name] / rows['far'][name]:.2f}" in cells
            assert f"{rows['near']['psnr']:.2f}" in cells
            assert f"{rows['near']['psnr'] - rows['far']['psnr']:+.2f}" in cells
        assert "12 ms" in cells
        assert "radius 8" in cells

    def test_without_flip_the_page_says_so(self, report, monkeypatch):
        assert "FLIP is left out" not in make_page(report)
        monkeypatch.setitem(sys.modules, "flip_evaluator", None)
        page = make_page(report)
        assert "FLIP is left out: the package flip-evaluator is not installed." in page
        assert '<th scope="col">FLIP</th>' not in page

    def test_the_magnifier_starts_where_the_two_differ(self, report):
        data = json.loads(re.search(r'id="data">(.*?)</script>', make_page(report), re.DOTALL)[1])
        x, y = data["spot"]
        assert x - 32 <= 30
        assert x + 32 >= 60
        assert y - 32 <= 20
        assert y + 32 >= 50
        assert (data["width"], data["height"]) == (80, 70)

    def test_small_pictures_and_no_mask(self, report):
        cut = [replace(one, image=one.image[:3, :5]) for one in [*report.pictures, report.reference]]
        page = make_page(replace(report, pictures=cut[:2], reference=cut[2], mask=None))
        assert "Specular pixels," not in page

    def test_mistakes(self, report):
        with refuses(InputError, "picture"):
            make_page(replace(report, right="nearer"))
        with refuses(InputError, "picture key", "'\"><x'"):
            make_page(replace(report, pictures=[replace(report.pictures[0], key='"><x')]))
        with refuses(InputError, "picture key", "'far'"):
            make_page(replace(report, pictures=[report.pictures[0]] * 2))
        bad = replace(report.pictures[1], image=report.pictures[1].image * np.nan)
        with refuses(InputError, "image", "5600 of 5600 pixels that are NaN or infinite, the first at x=0, y=0"):
            make_page(replace(report, pictures=[report.pictures[0], bad]))
        small = replace(report.pictures[1], image=report.pictures[1].image[:5])
        with refuses(InputError, "image", "80x5"):
            make_page(replace(report, pictures=[report.pictures[0], small]))


BROWSER = next(
    (found for name in ("chromium", "chromium-browser", "google-chrome") if (found := shutil.which(name))), None
)

# Runs after the page's own script; leaves what it saw in the title.
PROBE = """
<script>
const stage = document.getElementById("stage"), handle = document.getElementById("handle");
const wipe = () => Math.round(parseFloat(stage.style.getPropertyValue("--wipe")));
const seen = {start: wipe(), hidden: document.getElementById("compare").hidden};
stage.setPointerCapture = () => {};
const point = (kind, share, touch) => {
  const box = stage.getBoundingClientRect();
  stage.dispatchEvent(new PointerEvent(kind, {
    clientX: box.left + share * box.width, clientY: box.top + 0.5 * box.height, button: 0, pointerId: 1,
    pointerType: touch ? "touch" : "mouse", bubbles: true, cancelable: true,
  }));
};
point("pointermove", 0.9); seen.hover = wipe();
point("pointerdown", 0.25); seen.press = wipe();
point("pointermove", 0.75, true); seen.drag = wipe();
point("pointerup", 0.75, true); point("pointermove", 0.1); seen.after = wipe();
seen.focus = document.activeElement.id;
const key = (element, name, shift) => element.dispatchEvent(new KeyboardEvent("keydown", {key: name, shiftKey: shift}));
key(handle, "ArrowRight"); seen.right = wipe();
key(handle, "ArrowLeft", true); seen.left = wipe();
key(handle, "End"); seen.end = wipe(); seen.aria = handle.getAttribute("aria-valuenow");
key(handle, "Home"); seen.home = wipe();
const spot = document.getElementById("spot"), loupe = document.getElementById("loupe");
const before = spot.style.top; key(loupe, "ArrowUp", true); seen.moved = spot.style.top !== before;
const select = document.getElementById("right");
select.value = "reference"; select.dispatchEvent(new Event("change"));
seen.under = document.getElementById("under").className;
document.querySelector("input[value=e]").click();
seen.over = document.getElementById("over").className;
seen.legend = document.getElementById("legend").hidden;
seen.tiles = [...loupe.querySelectorAll(".tile")].map((tile) => tile.className);
document.title = JSON.stringify(seen);
</script>
"""


@pytest.mark.nightly
@pytest.mark.skipif(BROWSER is None, reason="no chromium on the path: apt-get install chromium")
def test_the_page_works_in_a_browser(report, tmp_path):
    page = tmp_path / "report.html"
    page.write_text(make_page(report).replace("</body>", PROBE + "</body>"), encoding="utf-8")
    flags = ["--headless", "--no-sandbox", "--disable-gpu", "--disable-background-networking", "--window-size=1000,900"]
    done = subprocess.run(
        [BROWSER, *flags, f"--user-data-dir={tmp_path / 'profile'}", "--dump-dom", page.as_uri()],
        capture_output=True, text=True, timeout=120, check=True,
    )  # fmt: skip
    seen = json.loads(html.unescape(re.search(r"<title>(.*?)</title>", done.stdout, re.DOTALL)[1]))
    assert seen == {
        "start": 50, "hidden": False, "hover": 50, "press": 25, "drag": 75, "after": 75, "focus": "handle",
        "right": 76, "left": 66, "end": 100, "aria": "100", "home": 0, "moved": True,
        "under": "layer p-reference", "over": "layer e-far", "legend": False,
        "tiles": ["tile e-far", "tile e-near", "tile "],
    }  # fmt: skip


class TestDemo:
    @pytest.fixture
    def small(self, monkeypatch):
        """Cut the frame inside the package down, so that the demonstration is quick."""
        full, reference, samples = demo.load_bundled()
        rows, columns = slice(120, 160), slice(40, 90)

        def cut(value):
            return None if value is None else value[rows, columns]

        def cut_all(part):
            return type(part)(**{name: cut(value) for name, value in vars(part).items()})

        frame = Frame(cut_all(full.radiance), cut_all(full.gbuffer), camera=full.camera, spp=full.spp)
        monkeypatch.setattr(demo, "load_bundled", lambda: (frame, cut(reference), samples))
        return frame

    def test_the_frame_inside_the_package(self):
        frame, reference, samples = demo.load_bundled()
        assert reference.shape == (*frame.shape, 3)
        assert np.isfinite(reference).all()
        assert (frame.spp, frame.camera is not None, frame.half_a is not None) == (32, True, True)
        assert samples >= 1024
        assert rel_mse(frame.radiance.color, reference) < 0.1

    @pytest.mark.nightly
    def test_the_difference_to_the_peer_can_be_seen(self):
        if not demo.has_oidn():
            pytest.skip("needs Open Image Denoise")
        frame, reference, _ = demo.load_bundled()
        sheet = np.zeros(frame.shape, bool)
        sheet[90:125, 40:185] = True  # the lines in small print
        ours, peer = (rel_mse(image, reference, sheet) for image in (denoise(frame).image, denoise_oidn(frame)[0]))
        assert ours < 0.6 * peer

    def test_the_page_tells_everything(self, small, tmp_path, monkeypatch):
        said, told, calls = [], [], []
        monkeypatch.setattr(demo, "denoise", lambda *given, **named: calls.append(named) or denoise(*given, **named))
        page = demo.make_demo(tmp_path / "a" / "b", tell=said.append, progress=lambda *step: told.append(step))
        assert page == tmp_path / "a" / "b" / "report.html"
        text = page.read_text(encoding="utf-8")
        peer = demo.has_oidn()
        ours = "own filters, comparing what surfaces reflect, quality high (Open"
        made = "Here: Open Image Denoise with and without albedo and normal, mixed" if peer else ours
        for words in ("noisy", "reference", made, "Specular pixels", "lobewise demo", "threads", "printed sheet"):
            assert words in text
        assert calls == [{"device": "auto"}]
        assert "normal-aware" not in text
        left = "oidn" if peer else "noisy"
        assert f'"left": "{left}", "right": "default"' in text
        assert ("Open Image Denoise is a neural network" in text) == peer
        steps = ["Filtering: lobewise.", *(["Filtering: Open Image Denoise."] if peer else [])]
        assert said == [*steps, f"Measuring the errors of {'three' if peer else 'two'} pictures."]
        assert told == [("Measuring", done, 2 + peer) for done in range(3 + peer)]

    def test_all_methods_of_the_story(self, small, tmp_path):
        text = demo.make_demo(tmp_path, everything=True).read_text(encoding="utf-8")
        for words in (
            "normal-aware",
            "band-limited",
            "single SG",
            "ggx lobe",
            "normal_exponent",
            "lobewise demo --all",
        ):
            assert words in text
        assert text.count("quality fast") == 4
        assert text.count("quality balanced") == 2

    def test_without_the_neural_peer_it_says_so(self, small, tmp_path, monkeypatch):
        monkeypatch.setattr(demo, "has_oidn", lambda: False)
        monkeypatch.setattr(demo, "explain_no_oidn", lambda: "It is absent; pip install it")
        text = demo.make_demo(tmp_path).read_text(encoding="utf-8")
        assert "It is absent; pip install it adds it to this page" in text
        assert "p-oidn" not in text

    def test_where_no_filter_can_run_the_peer_is_shown(self, small, tmp_path, monkeypatch):
        settings = {"with_oidn": True}
        result = replace(denoise(small, quality="fast"), settings=settings, method="Open Image Denoise, alone")
        monkeypatch.setattr(demo, "denoise", lambda *_, **__: result)
        assert "Here: Open Image Denoise, alone." in demo.make_demo(tmp_path).read_text(encoding="utf-8")

    def test_folders_that_cannot_be(self, tmp_path):
        (tmp_path / "file").write_text("")
        for folder in (tmp_path / "file", tmp_path / "file" / "below", "/proc/demo", "a\0b"):
            with refuses(FileError, expected="a folder that can be made"):
                demo.make_demo(folder)

    @pytest.mark.mitsuba
    def test_live(self, tmp_path):
        page = demo.make_demo(tmp_path, live=True, scene="brushed", spp=2, reference_spp=4, size=32)
        text = page.read_text(encoding="utf-8")
        assert "lobewise demo --live --scene brushed --spp 2 --reference-spp 4 --size 32" in text
        assert "2 samples per pixel, filtered" in text
        assert "Brushed, path traced." in text
