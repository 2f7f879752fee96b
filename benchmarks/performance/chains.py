"""Time of the exported chains of compute passes on a graphics card, by wgpu: whole frames, and every pass alone.

    python -m benchmarks.performance.chains -o benchmarks/results/chains.json     # needs wgpu and a graphics card

The frame is a floor of tiles under noise, so that every pixel has a surface and no pass ends early. The time of a frame
is that of many frames in a row divided by their number; inputs stay on the card.
"""

import argparse
import json
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lobewise.exporting.shaders.chains import make_chain
from lobewise.exporting.shaders.constants import compute_constants, pack_constants
from lobewise.exporting.shaders.passes import WORKGROUP, Chain, Lifetime, Pass, write_pass
from lobewise.records.camera import Camera
from lobewise.settings import ResolvedSettings

CASES = (
    ("filter", "separable", 8),
    ("filter", "atrous", 8),
    ("history", "separable", 8),
    ("history", "atrous", 8),
    ("upsample", "full", 5),
)
"""Chain, form and radius."""
SCALE = 2
"""Distance of the samples of the chain "upsample", pixels."""
MIN_SECONDS = 0.2
"""Shortest time that is measured."""
Images = dict[str, NDArray[np.float32]]
ROUNDS = 3
"""The best of so many times counts."""


class LoadedChain:
    """A chain on a device, with its images. Images of the frame before are those of this frame."""

    def __init__(
        self, device: Any, chain: Chain, values: dict[str, Any], given: dict[str, NDArray[np.float32]]
    ) -> None:
        import wgpu

        self.device, self.chain, self.values = device, chain, values
        self.views: dict[str, Any] = {}
        usage = wgpu.TextureUsage
        for image in chain.images:
            size = values[image.extent[0]], values[image.extent[1]], 1
            flags = usage.TEXTURE_BINDING | usage.STORAGE_BINDING | usage.COPY_DST
            texture = device.create_texture(size=size, format="rgba32float", usage=flags)
            if image.lifetime is Lifetime.GIVEN:
                pixels = np.ascontiguousarray(given[image.name][: size[1], : size[0]])
                layout = {"bytes_per_row": 16 * size[0], "rows_per_image": size[1]}
                device.queue.write_texture({"texture": texture}, pixels, layout, size)
            self.views[image.name] = texture.create_view()
        block = pack_constants(chain.constants, values)
        self.block = device.create_buffer_with_data(data=block, usage=wgpu.BufferUsage.UNIFORM)
        self.signal = device.create_buffer(size=4, usage=wgpu.BufferUsage.COPY_SRC)
        self.passes = [self._load(each) for each in chain.passes]

    def _load(self, each: Pass) -> tuple[Any, Any, list[int]]:
        """Return pipeline, bound images and number of workgroups of a pass."""
        module = self.device.create_shader_module(code=write_pass(self.chain, each, "wgsl"))
        stage = {"module": module, "entry_point": "main"}
        pipeline = self.device.create_compute_pipeline(layout="auto", compute=stage)
        images = [*each.reads.values(), *each.writes.values()]
        entries = [{"binding": 0, "resource": {"buffer": self.block}}]
        entries += [{"binding": k, "resource": self.views[name]} for k, name in enumerate(images, 1)]
        group = self.device.create_bind_group(layout=pipeline.get_bind_group_layout(0), entries=entries)
        groups = [-(-self.values[side] // count) for side, count in zip(each.extent, WORKGROUP, strict=True)]
        return pipeline, group, groups

    def run(self, numbers: range, count: int) -> None:
        """Run some of the passes ``count`` times and wait until they are done."""
        encoder = self.device.create_command_encoder()
        for _ in range(count):
            for number in numbers:
                pipeline, group, groups = self.passes[number]
                step = encoder.begin_compute_pass()
                step.set_pipeline(pipeline)
                step.set_bind_group(0, group)
                step.dispatch_workgroups(*groups)
                step.end()
        self.device.queue.submit([encoder.finish()])
        # To read a buffer waits for everything before. `on_submitted_work_done_sync` fails in wgpu 0.32.
        self.device.queue.read_buffer(self.signal)


def time_runs(run: Callable[[int], None]) -> float:
    """Return the seconds of one run, the best of some rounds of many runs."""
    run(1)
    count, seconds = 1, 0.0
    while seconds < MIN_SECONDS:
        count = count if seconds == 0.0 else max(2 * count, int(1.2 * count * MIN_SECONDS / seconds))
        start = time.perf_counter()
        run(count)
        seconds = time.perf_counter() - start
    best = seconds
    for _ in range(ROUNDS - 1):
        start = time.perf_counter()
        run(count)
        best = min(best, time.perf_counter() - start)
    return best / count


def make_images(camera: Camera, height: int, width: int) -> Images:
    """Return what a chain is given, (height, width, 4) each: a floor of tiles whose roughness differs."""
    rng = np.random.default_rng(1)
    rays = camera.make_ray_directions(width, height)
    depth = -camera.position[1] / rays[..., 1:2]
    place = camera.position + depth * rays
    tiles = (np.floor(place[..., :1]) + np.floor(place[..., 2:])) % 2
    flat = np.ones((height, width, 1))
    light = rng.gamma(0.5, 2.0, (2, height, width, 3))
    images = {
        "surface": (0.0 * flat, flat, 0.0 * flat, 0.08 + 0.3 * tiles),
        "place": (place, depth),
        "motion": (0.3 * flat, 0.2 * flat, flat, flat),
        "hits": (2.0 * flat, flat, flat, flat),
        "diffuse": (0.4 * light[0], flat),
        "specular": (0.6 * light[1], flat),
        "diffuse_albedo": (0.4 * flat, 0.4 * flat, 0.4 * flat, flat),
        "specular_albedo": (0.6 * flat, 0.6 * flat, 0.6 * flat, flat),
        "emission": (0.0 * flat, 0.0 * flat, 0.0 * flat, flat),
    }
    return {name: np.concatenate(parts, axis=-1).astype(np.float32) for name, parts in images.items()}


def measure(device: Any, height: int, width: int) -> list[dict[str, Any]]:
    """Return the milliseconds of every chain and pass."""
    camera = Camera(position=(0.0, 2.0, 0.0), forward=(0.0, -1.0, -1.0), up=(0.0, 1.0, 0.0), fov_y=0.7)
    images = make_images(camera, height, width)
    found = []
    for name, form, radius in CASES:
        settings = ResolvedSettings(
            quality="fast",
            similarity="ggx",
            form=form,
            radius=radius,
            beta=2.5,
            diffuse_beta=2.5,
            device="cpu",
            screen_sigma=float(radius),
            position_sigma=16.0,
            tau=0.06,
            normal_exponent=64.0,
            band_limit=None,
            lobes=3,
            with_oidn=False,
        )
        scale = SCALE if name == "upsample" else 1
        values = compute_constants(camera, (height, width), settings, previous=camera, own=1.01, scale=scale)
        chain = LoadedChain(device, make_chain(name, form=form), values, images)
        every = range(len(chain.passes))
        frame = time_runs(lambda count, chain=chain, every=every: chain.run(every, count))
        alone = {
            each.name: 1e3 * time_runs(lambda count, chain=chain, k=k: chain.run(range(k, k + 1), count))
            for k, each in enumerate(chain.chain.passes)
        }
        print(f"{name} {form}: {1e3 * frame:.3f} ms", flush=True)
        found.append({"chain": name, "form": form, "radius": radius, "frame_ms": 1e3 * frame, "pass_ms": alone})
    return found


def main() -> None:
    """Time the chains and write JSON."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--width", type=int, default=1920)
    parser.add_argument("--height", type=int, default=1080)
    parser.add_argument("-o", "--output", type=Path, required=True)
    asked = parser.parse_args()
    import wgpu

    adapters = [each for each in wgpu.gpu.enumerate_adapters_sync() if each.info["backend_type"] == "Vulkan"]
    adapter = min(adapters, key=lambda each: each.info["adapter_type"] != "DiscreteGPU")
    told = {name: str(adapter.info[name]) for name in ("device", "description", "adapter_type", "backend_type")}
    print(told, flush=True)
    found = measure(adapter.request_device_sync(), asked.height, asked.width)
    result = {"adapter": told, "width": asked.width, "height": asked.height, "scale": SCALE, "chains": found}
    asked.output.write_text(json.dumps(result, indent=1) + "\n")


if __name__ == "__main__":
    main()
