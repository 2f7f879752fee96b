"""The theory page names every public function of the lobes and of their oracles, and only such as there are."""

import importlib
import inspect
import re
from pathlib import Path

import pytest

PAGE = (Path(__file__).parents[2] / "docs" / "developers" / "theory.md").read_text()
LOBES = ["albedo", "clusters", "covariance", "directions", "gaussian", "roughness"]
ORACLES = ["brdf", "mixture", "sg", "tangent"]


@pytest.mark.parametrize(
    ("named", "module"),
    [
        ("ggx", "lobewise.fitting.ggx"),
        *((name, f"lobewise.lobes.{name}") for name in LOBES),
        *((f"oracles.{name}", f"tests.lobes.oracles.{name}") for name in ORACLES),
    ],
)
def test_page_and_module_name_the_same_functions(named, module):
    public = {
        key
        for key, value in inspect.getmembers(importlib.import_module(module), inspect.isfunction)
        if value.__module__ == module and not key.startswith("_")
    }
    assert set(re.findall(rf"`{re.escape(named)}\.(\w+)`", PAGE)) == public - {
        "are_above",
        "evaluate_microfacet",
        "make_positive",
    }
