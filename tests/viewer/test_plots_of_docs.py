"""The plots of docs/developers/how_it_works.md compute what the package computes, and follow their sliders."""

import re
from pathlib import Path
from typing import Any

import numpy as np

from lobewise.denoising.automatic import choose_beta
from lobewise.fitting.ggx import ggx_brdf
from lobewise.lobes import gaussian
from lobewise.lobes.numbers import NUMPY
from tests.lobes.oracles.sg import sg_slide_similarity

DOCS = Path(__file__).parents[2] / "docs"
VIEW, LIGHT, ALPHA = 0.5, 0.7, 0.3


def point(angle: float) -> list[float]:
    """Return the direction at an angle from the normal."""
    return [np.sin(angle), 0.0, np.cos(angle)]


def test_plots(browser: Any, tmp_path: Path) -> None:
    page = (DOCS / "developers" / "how_it_works.md").read_text()
    plots = re.findall(r'<div class="lobe-plot".*?</div>', page, flags=re.S)
    script = (DOCS / "_static" / "lobes.js").read_text()
    path = tmp_path / "plots.html"
    path.write_text(f"<!doctype html><meta charset=utf-8>{''.join(plots)}<script>{script}</script>")
    page = browser.new_page()
    problems: list[str] = []
    page.on("pageerror", lambda problem: problems.append(str(problem)))
    page.goto(path.as_uri())

    sharpness = page.evaluate("() => [[0.05, 1], [0.2, 0.5], [0.6, 0.05]].map((x) => lobes.findSharpness(...x))")
    variances = [
        gaussian.compute_ggx_variance(NUMPY, c, (a, a), 0.0) for a, c in ((0.05, 1.0), (0.2, 0.5), (0.6, 0.05))
    ]
    np.testing.assert_allclose(sharpness, 1.0 / np.array(variances), rtol=1e-6)

    angles = (0.0, 0.1, 0.7)
    found = [page.evaluate("(x) => lobes.findSimilarity(40, 9, x)", angle) for angle in angles]
    expected = [sg_slide_similarity(point(0.0), 40.0, point(angle), 9.0) for angle in angles]
    np.testing.assert_allclose(found, expected, rtol=1e-6)

    found = page.evaluate("(x) => lobes.evaluateGgx(...x)", [ALPHA, VIEW, LIGHT])
    np.testing.assert_allclose(found, ggx_brdf(point(-VIEW), point(LIGHT), ALPHA) * np.cos(LIGHT), rtol=1e-6)

    found = [page.evaluate("(x) => lobes.chooseExponent(x)", spp) for spp in (1, 4, 300000)]
    np.testing.assert_allclose(found, [choose_beta(spp) for spp in (1, 4, 300000)])

    assert len(plots) == page.locator(".lobe-plot svg").count() == 2
    for number in range(2):
        plot = page.locator(".lobe-plot").nth(number)
        shown = plot.locator("path").first.get_attribute("d"), plot.locator("p").inner_text()
        assert all(shown)
        plot.locator("input").first.fill("0.5")
        assert plot.locator("path").first.get_attribute("d") != shown[0]
        assert plot.locator("p").inner_text() != shown[1]
        assert plot.locator("output").first.inner_text() == "0.5"
    page.close()
    assert problems == []
