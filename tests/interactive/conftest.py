"""Fixtures of the rendering tests."""

from tests.render.conftest import make_furnace  # noqa: F401 - a fixture
