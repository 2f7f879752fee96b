"""The page of examples/web: its files, the sequence inside it, and what a headless browser computes and shows."""

import base64
import importlib.util
import io
import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from examples.web.make_page import PAGE_CHAINS, PAGE_SETTINGS, SEQUENCE, main, take_samples, write_page
from examples.web.packing import LIGHT_BITS, pack_frames, read_frames

import lobewise
from lobewise.exporting.names import CHAINS
from lobewise.exporting.shaders.chains import make_chain
from lobewise.exporting.shaders.passes import write_pass
from lobewise.records.frame import FloatArray, Frame
from lobewise.settings import FORM_NAMES
from tests.exporting.chain_scene import make_frame
from tests.exporting.conftest import lack

FLAGS = [
    "--no-sandbox",
    "--enable-unsafe-webgpu",
    "--use-webgpu-adapter=swiftshader",
    "--enable-features=Vulkan",
    "--use-vulkan=swiftshader",
    "--use-angle=vulkan",
]
"""WebGPU in software, and a canvas that it can draw on."""
PATIENCE = 120_000.0
"""Milliseconds until a page is open."""
FRAMES = 4
"""Frames that are compared: software is slow."""
PAGE_RTOL = 1e-2
MAX_BYTES = 3_000_000


@pytest.fixture(scope="module")
def engine() -> Iterator[Any]:
    """Return a headless browser with WebGPU in software."""
    found = next((path for name in ("chromium", "google-chrome") if (path := shutil.which(name))), None)
    if found is None or importlib.util.find_spec("playwright") is None:
        lack("the page needs a browser and a driver: apt install chromium, pip install playwright")
    from playwright.sync_api import sync_playwright

    with sync_playwright() as driver:
        launched = driver.chromium.launch(executable_path=found, args=FLAGS)
        yield launched
        launched.close()


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    place = tmp_path_factory.mktemp("web") / "page"
    write_page(place)
    return place


@pytest.fixture(scope="module")
def frames() -> list[Frame]:
    return read_frames(SEQUENCE)


class Window:
    """An open page. Whatever its console calls an error is kept."""

    def __init__(self, engine: Any, folder: Path, script: str = "") -> None:
        self.errors: list[str] = []
        self.page = engine.new_page()
        self.page.set_default_timeout(PATIENCE)
        self.page.on("console", lambda message: message.type == "error" and self.errors.append(message.text))
        self.page.on("pageerror", lambda problem: self.errors.append(str(problem)))
        if script:
            self.page.add_init_script(script)
        self.page.goto((folder / "index.html").as_uri())
        self.page.evaluate("page.opened")

    @property
    def message(self) -> str:
        return str(self.page.inner_text("#message"))

    def read_image(self, size: tuple[int, int]) -> FloatArray:
        numbers = self.page.evaluate("page.readImage().then((image) => Array.from(image))")
        return np.array(numbers, np.float32).reshape(*size, 4)

    def read_canvas(self) -> FloatArray:
        """Return what the canvas shows, (height, width, 3), 0 to 1."""
        from PIL import Image

        address = self.page.evaluate("(page.draw(), document.getElementById('picture').toDataURL('image/png'))")
        image = Image.open(io.BytesIO(base64.b64decode(address.partition(",")[2])))
        return np.asarray(image.convert("RGB"), np.float32) / 255.0


@pytest.fixture(scope="module")
def window(engine: Any, folder: Path) -> Iterator[Window]:
    opened = Window(engine, folder)
    if opened.message:
        lack(f"this browser runs no WebGPU in software: {opened.message}")
    opened.page.evaluate("page.setPlaying(false)")
    opened.page.evaluate("page.running")
    yield opened
    opened.page.close()


def compute(chain: str, frames: list[Frame]) -> FloatArray:
    """Return Python's result of the last frame."""
    settings = PAGE_SETTINGS[chain]
    if chain == "filter":
        return lobewise.denoise(frames[-1], settings).image
    recipe = lobewise.TemporalFilter(settings)
    return [recipe.add(frame).image for frame in (take_samples(frames) if chain == "upsample" else frames)][-1]


@pytest.mark.nightly
@pytest.mark.parametrize("chain", PAGE_CHAINS)
def test_browser_agrees_with_python(window: Window, frames: list[Frame], chain: str) -> None:
    shown = frames[:FRAMES]
    window.page.evaluate(f"page.chosen = {list(PAGE_CHAINS).index(chain)}")
    window.page.evaluate(f"page.seek({FRAMES - 1})")
    image = window.read_image(shown[0].shape)[..., :3]
    expected = compute(chain, shown)
    assert np.isfinite(image).all()
    assert np.max(np.abs(image - expected) / np.maximum(expected, 1e-2)) < PAGE_RTOL
    assert (window.message, window.errors) == ("", [])


@pytest.mark.nightly
def test_canvas_shows_both_sides_of_the_line(window: Window, frames: list[Frame]) -> None:
    window.page.evaluate("page.chosen = 1")
    window.page.evaluate("page.seek(1)")
    size = frames[0].shape
    clean, noisy = window.read_image(size)[..., :3], frames[1].radiance.color
    window.page.evaluate("page.setLine(0.25)")
    canvas, line = window.read_canvas(), round(0.25 * size[1])

    def encode(light: FloatArray) -> FloatArray:
        light = np.clip(light, 0.0, 1.0)
        return np.where(light <= 0.0031308, 12.92 * light, 1.055 * light ** (1 / 2.4) - 0.055)

    assert np.abs(canvas[:, :line] - encode(noisy[:, :line])).max() < 2.0 / 255.0
    assert np.abs(canvas[:, line + 1 :] - encode(clean[:, line + 1 :])).max() < 2.0 / 255.0
    assert np.all(canvas[:, line] == 1.0)
    # Both sides differ where they are not alike by chance.
    assert np.abs(encode(noisy) - encode(clean)).mean() > 0.05


@pytest.mark.nightly
def test_page_plays(window: Window) -> None:
    window.page.evaluate("page.chosen = 1")
    window.page.evaluate("page.seek(0)")
    assert window.page.inner_text("#frame").startswith("Frame 1 of ")
    window.page.click("#play")
    window.page.wait_for_function("document.getElementById('frame').textContent.startsWith('Frame 3 ')")
    window.page.click("#play")
    assert window.page.inner_text("#play") == "Play"
    window.page.evaluate("page.running")
    assert window.errors == []


COMPILE = """async (text) => {
    const module = page.device.createShaderModule({ code: text });
    const told = (await module.getCompilationInfo()).messages.map((one) => `${one.lineNum}: ${one.message}`);
    page.device.pushErrorScope("validation");
    page.device.createComputePipeline({ layout: "auto", compute: { module, entryPoint: "main" } });
    const error = await page.device.popErrorScope();
    return error ? [...told, error.message] : told;
}"""


@pytest.mark.nightly
def test_browser_compiles_every_pass(window: Window) -> None:
    """The tests of chains use another compiler of WGSL than Chromium has."""
    chains = [make_chain(name, similarity="sg") for name in CHAINS]
    chains += [
        make_chain(name, form=form) for name in CHAINS for form in (("full",) if name == "upsample" else FORM_NAMES)
    ]
    for chain in chains:
        for each in chain.passes:
            assert window.page.evaluate(COMPILE, write_pass(chain, each, "wgsl")) == [], (chain.name, each.name)
    assert window.page.evaluate(COMPILE, "@compute @workgroup_size(1) fn main() { let x: i32 = 1.5; }") != []
    window.errors.clear()


@pytest.mark.nightly
def test_says_what_is_missing(engine: Any, folder: Path) -> None:
    hidden = "Object.defineProperty(navigator, 'gpu', { value: undefined })"
    window = Window(engine, folder, hidden)
    assert window.message.startswith("This browser has no WebGPU")
    window.page.close()
    blind = "navigator.gpu.requestAdapter = async () => null"
    window = Window(engine, folder, f"if (navigator.gpu) {blind}")
    assert "finds no graphics card" in window.message
    window.page.close()


def test_bundle_keeps_frames(tmp_path: Path) -> None:
    frames = [make_frame(number, bad=False, hits=True) for number in (0, 1)]
    # Light is rounded twice: to half floats, and to fewer bits.
    light_rtol = 2.0 ** -(LIGHT_BITS + 1) + 2.0**-11
    (tmp_path / "bundle").write_bytes(pack_frames(frames))
    for frame, found in zip(frames, read_frames(tmp_path / "bundle"), strict=True):
        guides, kept = frame.gbuffer, found.gbuffer
        np.testing.assert_allclose(found.radiance.diffuse, frame.radiance.diffuse, rtol=light_rtol, atol=1e-6)
        np.testing.assert_allclose(kept.depth, guides.depth, rtol=5e-4)
        np.testing.assert_allclose(kept.normal, guides.normal, rtol=0.0, atol=5e-4)
        np.testing.assert_allclose(kept.position[kept.depth > 0], guides.position[kept.depth > 0], rtol=0.0, atol=4e-3)
        np.testing.assert_allclose(kept.hit_distance, guides.hit_distance, rtol=0.01)
        np.testing.assert_allclose(kept.mean_emission, guides.mean_emission, rtol=2e-3)
        np.testing.assert_array_equal(found.require_camera("it").position, frame.require_camera("it").position)
    assert np.abs(read_frames(tmp_path / "bundle")[1].gbuffer.motion).max() > 0.5


def test_files(folder: Path, frames: list[Frame]) -> None:
    names = {str(path.relative_to(folder)) for path in folder.rglob("*") if path.is_file()}
    assert names == {"index.html", "player.js", "sequence.js", "passes.js"}
    assert (folder / "sequence.js").stat().st_size < MAX_BYTES
    page = (folder / "index.html").read_text()
    assert f"{len(frames)} frames of {frames[0].width} x {frames[0].height} pixels" in page
    assert f'width="{frames[0].width}" height="{frames[0].height}"' in page
    # Without a server a page may load scripts, and nothing else.
    assert "http" not in (folder / "player.js").read_text()
    assert "fetch(" not in (folder / "player.js").read_text()


def test_program(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    monkeypatch.setattr("sys.argv", ["make_page", str(tmp_path / "new" / "page")])
    main()
    assert "index.html" in capsys.readouterr().out
    assert (tmp_path / "new" / "page" / "passes.js").stat().st_size > 100_000
