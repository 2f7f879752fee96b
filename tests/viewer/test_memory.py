"""The process that renders does not grow with the pictures that it gives; asked directly, quicker than by a page."""

import threading
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import pytest

from lobewise.interactive.settings import InteractiveSettings
from lobewise.viewer.messages import Description, Opened, Picture, Problem, Request, Target, Window
from lobewise.viewer.worker_process import WorkerProcess

pytestmark = pytest.mark.nightly

PATIENCE = 120.0
PICTURES = 64
GROWTH = 0.05
"""Over the last half of them."""


def ask_for_pictures(target: Target, make_request: Callable[[Description, int], Request]) -> list[int]:
    """Return the bytes that the process held after each of `PICTURES` pictures."""
    memory: list[int] = []
    problems: list[str] = []
    descriptions: list[Description] = []
    arrived = threading.Semaphore(0)

    def receive(report: Any) -> None:
        if isinstance(report, Opened):
            descriptions.append(report.description)
        elif isinstance(report, Picture) and report.final:
            memory.append(report.memory)
        elif isinstance(report, Problem):
            problems.append(report.text)
        else:
            return
        arrived.release()

    worker = WorkerProcess(target, receive, lambda text, again: problems.append(text))
    worker.start()
    try:
        assert arrived.acquire(timeout=PATIENCE)
        for number in range(PICTURES):
            assert not problems
            worker.submit(make_request(descriptions[0], number))
            assert arrived.acquire(timeout=PATIENCE)
    finally:
        worker.stop()
    assert problems == []
    return memory


@pytest.mark.mitsuba
def test_an_orbit_of_a_scene(mi: Any) -> None:
    settings = InteractiveSettings(similarity="none", adaptive=0.0, temporal=False, filter_direct=False, scale=8)

    def make_request(description: Description, number: int) -> Request:
        step = 0.02 * (16 - abs(16 - number % 32))
        camera = replace(description.camera, position=description.camera.position + step * description.camera.right)
        return Request(1, number, Window(300, 200), settings, camera, size=(96, 64))

    memory = ask_for_pictures(Target("showroom", (96, 64)), make_request)
    assert memory[-1] < (1.0 + GROWTH) * memory[PICTURES // 2]
