"""Render the frame and the reference that `lobewise demo` shows, into the package.

Run as ``python -m benchmarks.pictures.demo_frame``; with 4096 samples per pixel the reference takes minutes. Channels
that the demonstration does not read, or can make again (world positions, from depth and camera), are left out.
"""

from __future__ import annotations

import argparse
from dataclasses import replace
from pathlib import Path

import numpy as np

from benchmarks.common import ROOT
from lobewise.cli.demo import FRAME, REFERENCE, REFERENCE_SEED, restore_positions
from lobewise.frame import Frame, GBuffer, Radiance
from lobewise.io import write_frame
from lobewise.render import load_scene, render_frame, render_reference

DATA = ROOT / "src" / "lobewise" / "data"
LIMIT = 6_000_000


def choose_channels(frame: Frame) -> Frame:
    """Return what the filters of the demonstration read."""
    full, radiance = frame.gbuffer, frame.radiance
    gbuffer = GBuffer(
        depth=full.depth,
        normal=full.normal,
        alpha_u=full.alpha_u,
        lobe_kind=full.lobe_kind,
        diffuse_albedo=full.diffuse_albedo,
        specular_albedo=full.specular_albedo,
    )
    if not np.array_equal(full.alpha_u, full.alpha_v):
        gbuffer = replace(gbuffer, alpha_v=full.alpha_v, tangent=full.tangent)
    small = Frame(
        Radiance(radiance.color, radiance.diffuse, radiance.specular), gbuffer, camera=frame.camera, spp=frame.spp
    )
    error = np.abs(restore_positions(small).gbuffer.position - full.position)[full.depth > 0.0].max()
    if not error < 1e-3:
        raise SystemExit(f"positions made from depth are off by {error}: store them")
    return small


def main() -> None:
    """Render and write."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--spp", type=int, default=4)
    parser.add_argument("--reference-spp", type=int, default=4096)
    parser.add_argument("--size", type=int, default=512)
    parser.add_argument("--output", type=Path, default=DATA)
    options = parser.parse_args()
    scene = load_scene("showroom", width=options.size, height=options.size)
    frame = choose_channels(render_frame(scene, spp=options.spp))
    write_frame(options.output / FRAME, frame, attributes={"lobewise/scene": "showroom"})
    reference = render_reference(scene, spp=options.reference_spp, seed=REFERENCE_SEED)
    write_frame(options.output / REFERENCE, reference, attributes={"lobewise/scene": "showroom"})
    size = sum((options.output / name).stat().st_size for name in (FRAME, REFERENCE))
    print(f"{size / 1e6:.2f} MB in {options.output}")
    if size > LIMIT:
        raise SystemExit(f"together they should stay below {LIMIT / 1e6:.0f} MB")


if __name__ == "__main__":
    main()
