"""Read the camera of a USD stage in a process of its own, which `lobewise.interchange.cameras.usd` starts.

OpenUSD opens whatever a stage names, also pipes, and expands a few kilobytes to 10^9 prims. This process has limits.
"""

from __future__ import annotations

import json
import os
import signal
import stat
import sys
from contextlib import suppress
from pathlib import Path
from typing import Any

from lobewise.errors import FileError, InputError, LobewiseError
from lobewise.io.files import say_reason

MAX_SECONDS = 20
"""Most processor time to read a stage, seconds. It does not depend on what else the machine does."""
MAX_WALL_SECONDS = 180
"""Longest time to wait for a stage, seconds: a layer that is a pipe takes no processor time."""
MAX_BYTES = 2 << 30
"""Most memory of the process that reads a stage, bytes of address space."""


def read_first_camera(path: str) -> dict[str, Any]:
    """Return the first camera of a stage, at the first time of the stage.

    ``position``, ``forward`` and ``up`` are vectors of the world, shape (3,). ``low`` and ``high`` are the corners of
    the window on the plane at distance 1, shape (2,).

    Raises
    ------
    FileError
        If OpenUSD cannot read the stage.
    InputError
        If a layer lies elsewhere or is no plain file, or if the stage has no camera or an orthographic one.
    """
    from pxr import Gf, Tf, Usd, UsdGeom

    what = f"camera {path!r}"
    refused = FileError(what, expected="a USD stage", got="none that can be read", action="export it again")
    try:
        # Hold the layers: the stage takes those that are open already.
        layers = _open_layers(os.path.abspath(path), what)
        if not layers:
            raise refused
        stage = Usd.Stage.Open(layers[0])
        # An asset path may be an expression, which only the stage evaluates.
        for layer in stage.GetUsedLayers():
            if not layer.anonymous:
                _require_inside(layer.realPath, os.path.abspath(path), what)
        first = next((prim for prim in stage.Traverse() if prim.IsA(UsdGeom.Camera)), None)
        if first is None:
            raise InputError(what, expected="a camera", got="none", action="export cameras as well")
        # OpenUSD reads values, and raises errors about them, only on access.
        time = stage.GetStartTimeCode() if stage.HasAuthoredTimeCodeRange() else Usd.TimeCode.Default()
        camera: Any = UsdGeom.Camera(first).GetCamera(time)
    except Tf.ErrorException as problem:
        raise refused from problem
    if camera.projection != Gf.Camera.Perspective:
        raise InputError(what, expected="a perspective camera", got="an orthographic one", action="render with one")
    frustum = camera.frustum
    return {
        "position": list(frustum.position),
        "forward": list(frustum.ComputeViewDirection()),
        "up": list(frustum.ComputeUpVector()),
        "low": list(frustum.window.min),
        "high": list(frustum.window.max),
    }


def _open_layers(path: str, what: str) -> list[Any]:
    """Return the layers of a stage, the root layer first; each is checked before OpenUSD opens it."""
    from pxr import Ar, Sdf, Tf

    resolver = Ar.GetResolver()
    layers: list[Any] = []
    waiting, known = [path], {path}
    with Ar.ResolverContextBinder(resolver.CreateDefaultContextForAsset(path)):
        while waiting:
            name = waiting.pop()
            resolved = str(resolver.Resolve(Sdf.Layer.SplitIdentifier(name)[0]))
            if not resolved:
                continue
            _require_inside(resolved, path, what)
            layer = None
            # A stage goes on without a layer that is damaged or of an unknown format.
            with suppress(Tf.ErrorException):
                layer = Sdf.Layer.FindOrOpen(name)
            if layer is None:
                continue
            layers.append(layer)
            assets = filter(None, layer.GetCompositionAssetDependencies())
            named = {Sdf.ComputeAssetPathRelativeToLayer(layer, one) for one in assets} - known
            waiting += named
            known |= named
    return layers


def _require_inside(layer: str, root: str, what: str) -> None:
    """Raise InputError unless a layer is a plain file in the folder of the root layer, or in a folder below it."""
    from pxr import Ar

    # Of a layer within a package (.usdz) check the package.
    file = os.path.realpath(Ar.SplitPackageRelativePathOuter(layer)[0])
    folder = os.path.dirname(os.path.realpath(root))
    action = "export the camera alone, into one file"
    expected = f"layers that are plain files in the folder {folder!r}"
    if not Path(file).is_relative_to(folder):
        raise InputError(what, expected=expected, got=f"the layer {layer!r} outside of it", action=action)
    try:
        is_plain = stat.S_ISREG(os.stat(file).st_mode)
    except OSError as problem:
        raise InputError(what, expected=expected, got=f"{layer!r}: {say_reason(problem)}", action=action) from problem
    if not is_plain:
        raise InputError(what, expected=expected, got=f"the device, pipe or folder {layer!r}", action=action)


def _limit_process() -> None:
    """Limit memory and time of this process. Windows has no such limits; there the parent process limits the time."""
    with suppress(ImportError, OSError, ValueError):
        import resource

        resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
        resource.setrlimit(resource.RLIMIT_CPU, (MAX_SECONDS, MAX_SECONDS))
        # Not every system has this limit, so it comes last.
        resource.setrlimit(resource.RLIMIT_AS, (MAX_BYTES, MAX_BYTES))
    # End this process also where its parent was killed. The parent ends it a little earlier.
    if hasattr(signal, "alarm"):
        signal.alarm(MAX_WALL_SECONDS + 5)


def _main(folder: str, path: str) -> None:
    """Print the camera of a stage as JSON, or the kind and the fields of an error."""
    os.chdir(folder)
    _limit_process()
    try:
        answer: Any = {"camera": read_first_camera(path)}
    except LobewiseError as problem:
        answer = {"error": type(problem).__name__, "fields": problem.fields}
    sys.stdout.write(f"\n{json.dumps(answer)}\n")


if __name__ == "__main__":
    _main(*sys.argv[1:])
