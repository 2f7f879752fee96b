"""Fixtures of the rendering tests."""

from tests.render.conftest import built_in_frames  # noqa: F401 - a fixture
