"""Settings of the documentation site: `pip install -e '.[docs]'`, then `sphinx-build -W docs html`."""

from __future__ import annotations

import posixpath
import re
from importlib.metadata import version as find_version
from typing import Any

REPOSITORY = "https://github.com/lobewise/lobewise"
LINK_OUT = re.compile(r"\]\((\.\./[^)\s]+)\)")

project = "lobewise"
author = "The lobewise authors"
copyright = author
version = release = find_version("lobewise")

extensions = [
    "myst_nb",
    "sphinx.ext.autodoc",
    "sphinx.ext.napoleon",
    "sphinx_copybutton",
    "sphinx_design",
]
exclude_patterns = ["**/.ipynb_checkpoints"]

myst_enable_extensions = ["attrs_inline", "colon_fence"]
myst_heading_anchors = 4
# Blocks without a language are commands.
highlight_language = "none"
# Languages that Pygments does not know; words of docstrings that name two attributes, such as "shape".
suppress_warnings = ["misc.highlighting_failure", "ref.python"]
# The tests run the notebooks; pages show the outputs that the files hold.
nb_execution_mode = "off"
nb_merge_streams = True

autodoc_member_order = "bysource"
autodoc_typehints = "none"
autodoc_default_options = {"members": True, "show-inheritance": False}
napoleon_google_docstring = False
napoleon_use_rtype = False
napoleon_use_ivar = True
python_use_unqualified_type_names = True
add_module_names = False

html_theme = "pydata_sphinx_theme"
html_title = "lobewise"
html_static_path = ["_static"]
html_css_files = ["site.css"]
html_js_files = ["wipe.js", "lobes.js"]
html_show_sourcelink = False
html_copy_source = False
html_favicon = "_static/mark.svg"
html_theme_options = {
    "logo": {"text": "lobewise", "image_light": "_static/mark.svg", "image_dark": "_static/mark.svg"},
    "icon_links": [{"name": "Repository", "url": REPOSITORY, "icon": "fa-brands fa-github"}],
    "header_links_before_dropdown": 7,
    "show_toc_level": 2,
    "navigation_with_keys": False,
    "show_prev_next": True,
    "search_bar_text": "Search",
    "footer_start": ["copyright"],
    "footer_end": [],
}
html_sidebars = {page: [] for page in ("index", "troubleshooting", "results", "paper")}


def lead_out(app: Any, page: str, source: list[str]) -> None:
    """Let relative links that leave docs/ name the file's address in the repository."""

    def replace(match: re.Match[str]) -> str:
        path = posixpath.normpath(posixpath.join("docs", posixpath.dirname(page), match[1]))
        return match[0] if path.startswith("docs/") else f"]({REPOSITORY}/blob/main/{path})"

    source[0] = LINK_OUT.sub(replace, source[0])


def setup(app: Any) -> None:
    """Register the functions of this file with Sphinx."""
    app.connect("source-read", lead_out)
