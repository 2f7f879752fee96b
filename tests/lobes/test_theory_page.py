"""The theory page names every public function of the lobes, and only such as there are."""

import importlib
import inspect
import re
from pathlib import Path

import pytest

PAGE = (Path(__file__).parents[2] / "docs" / "theory.md").read_text()
MODULES = ["sg", "roughness", "brdf", "tangent", "asg", "mixture", "field", "mixture_field", "hits"]
INNER = {"make_isotropic_lobe", "make_anisotropic_lobe"}  # the two halves of make_tangent_lobe, by component


@pytest.mark.parametrize("name", MODULES)
def test_page_and_module_name_the_same_functions(name):
    module = importlib.import_module(f"lobewise.lobes.{name}")
    public = {
        key
        for key, value in inspect.getmembers(module, inspect.isfunction)
        if value.__module__ == module.__name__ and not key.startswith("_")
    }
    assert set(re.findall(rf"`{name}\.(\w+)`", PAGE)) == public - INNER
