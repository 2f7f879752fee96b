"""Hypothesis draws the same examples in every run, without a deadline, so that a busy machine fails no test."""

from __future__ import annotations

from hypothesis import settings

settings.register_profile("repeatable", derandomize=True, deadline=None)
settings.load_profile("repeatable")
