"""A stand-in for the process that renders: its pictures take long and it says what it was asked for."""

import os
import time
from multiprocessing.connection import Connection

import numpy as np

from lobewise.errors import LobewiseError
from lobewise.interactive.settings import InteractiveSettings
from lobewise.records.camera import Camera
from lobewise.viewer.messages import Description, Opened, Picture, Problem, Request, Save, SavedFile, Target

SECONDS = 0.15
UNSEEN = "The pictures show no fog."
CAMERA = Camera(position=(0.0, 0.0, 4.0), forward=(0.0, 0.0, -1.0), up=(0.0, 1.0, 0.0), fov_y=0.8)


def run_slow_worker(pipe: Connection, target: Target) -> None:
    """Answer requests after `SECONDS`; number 666 ends the process, 13 fails. A foggy target has something unseen."""
    if target.name == "missing":
        pipe.send(Problem(LobewiseError("there is no such thing", action="look elsewhere")))
        return
    if target.name == "broken":
        pipe.send(Problem(RuntimeError("something is broken.")))
        return
    unseen = UNSEEN if target.name == "foggy" else ""
    settings = InteractiveSettings(similarity="none")
    pipe.send(Opened(Description(settings, 4, 4, CAMERA, unseen=unseen)))
    forgotten: list[int] = []
    while (command := pipe.recv()) is not None:
        if isinstance(command, Request):
            if command.number == 666:
                os._exit(7)
            time.sleep(SECONDS)
            if command.number == 13:
                pipe.send(Problem(LobewiseError("these settings do not go; choose others."), command.client))
            else:
                pixels = np.full((4, 4, 3), command.number % 256, np.uint8)
                pipe.send(Picture(command.client, command.number, pixels, (4, 4), 0.0, accumulated=int(command.fresh)))
        elif isinstance(command, Save):
            pipe.send(SavedFile(command.client, command.kind, repr(forgotten).encode()))
        else:
            forgotten.append(command.client)
        pipe.send(None)
