"""Runs the passes of exported chains on a device of wgpu."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from lobewise.exporting.shaders.constants import compute_constants, pack_constants
from lobewise.exporting.shaders.passes import WORKGROUP, Chain, Lifetime, Pass, write_pass
from lobewise.recipes.temporal.recipe import TemporalFilter, compute_own_weight
from lobewise.records.frame import FloatArray, Frame
from lobewise.records.sparse_frame import SparseFrame
from tests.exporting.shaders import compile_spirv, dispatch


def fill(*channels: Any) -> FloatArray:
    """Return an image of four channels from images of one or more; missing channels are 0."""
    image = np.dstack([np.asarray(channel, np.float32) for channel in channels])
    return np.ascontiguousarray(np.pad(image, [(0, 0), (0, 0), (0, 4 - image.shape[2])]))


def make_constants(
    recipe: TemporalFilter, frame: Frame | SparseFrame, previous: Frame | SparseFrame | None
) -> dict[str, Any]:
    """Return the constants of a frame that joins a history."""
    sparse = {"scale": frame.scale, "place": frame.place} if isinstance(frame, SparseFrame) else {}
    return compute_constants(
        frame.require_camera("a history"),
        frame.shape,
        recipe._resolve(frame),
        previous=None if previous is None else previous.camera,
        temporal=recipe.temporal,
        own=compute_own_weight(frame),
        **sparse,
    )


def give_images(frame: Frame | SparseFrame) -> dict[str, FloatArray]:
    """Return a frame as the images that a chain is given."""
    guides, radiance = frame.gbuffer, frame.radiance
    motion = guides.motion if guides.motion is not None else np.zeros((*frame.shape, 2))
    return {
        "surface": fill(guides.normal, guides.alpha_u),
        "place": fill(guides.position, guides.depth),
        "motion": fill(motion),
        "hits": fill(guides.hit_distance if guides.hit_distance is not None else np.zeros(frame.shape)),
        "diffuse": fill(radiance.diffuse),
        "specular": fill(radiance.specular),
        "diffuse_albedo": fill(guides.diffuse_albedo),
        "specular_albedo": fill(guides.specular_albedo),
        "emission": fill(guides.mean_emission),
    }


OP_DECORATE, BINDING, NON_READABLE = 71, 33, 25
"""Numbers of the SPIR-V specification."""


def forbid_reading(code: bytes, bindings: Sequence[int]) -> bytes:
    """Return a SPIR-V program whose images at some bindings are write-only. HLSL has no word for it, wgpu needs it."""
    words = np.frombuffer(code, np.uint32).tolist()
    place, added = 5, []
    while place < len(words):
        length, operation = words[place] >> 16, words[place] & 0xFFFF
        if operation == OP_DECORATE and words[place + 2] == BINDING and words[place + 3] in bindings:
            added += [3 << 16 | OP_DECORATE, words[place + 1], NON_READABLE]
            last = place + length
        place += length
    return np.array([*words[:last], *added, *words[last:]], np.uint32).tobytes()


@dataclass
class Player:
    """A chain in a language, on a device.

    Parameters
    ----------
    device : wgpu.GPUDevice
    chain : Chain
    language : str
        "wgsl", "glsl" or "hlsl"; the last two by way of the reference compiler.
    folder : path
        Where compiled passes are kept.
    """

    device: Any
    chain: Chain
    language: str
    folder: Path
    images: dict[str, FloatArray] = field(default_factory=dict)
    """The images that were given or written last, by name."""
    _pipelines: dict[str, Any] = field(default_factory=dict)
    _layouts: dict[str, Any] = field(default_factory=dict)

    def run(self, given: Mapping[str, FloatArray], constants: Mapping[str, Any]) -> FloatArray:
        """Run all passes on a frame and return the result, (height, width, 4)."""
        for image in self.chain.images:
            if image.lifetime is Lifetime.BEFORE:
                blank = np.zeros((constants["height"], constants["width"], 4), np.float32)
                self.images[image.name] = self.images.get(image.before, blank)
        self.images.update(given)
        for each in self.chain.passes:
            self.images.update(self.run_pass(each.name, self.images, constants))
        return self.images["image"]

    def run_pass(
        self, name: str, given: Mapping[str, FloatArray], constants: Mapping[str, Any]
    ) -> dict[str, FloatArray]:
        """Run one pass and return the images that it writes, by their names in the chain."""
        import wgpu

        each = next(one for one in self.chain.passes if one.name == name)
        block = pack_constants(self.chain.constants, constants)
        uniform = self.device.create_buffer_with_data(data=block, usage=wgpu.BufferUsage.UNIFORM)
        entries: list[dict[str, Any]] = [{"binding": 0, "resource": {"buffer": uniform}}]
        textures = {}
        for number, (binding, image) in enumerate([*each.reads.items(), *each.writes.items()], 1):
            extent = self.chain.get_image(image).extent
            size = constants[extent[0]], constants[extent[1]], 1
            is_written = binding in each.writes
            usage = wgpu.TextureUsage.COPY_DST | wgpu.TextureUsage.COPY_SRC
            usage |= wgpu.TextureUsage.STORAGE_BINDING if is_written else wgpu.TextureUsage.TEXTURE_BINDING
            texture = self.device.create_texture(size=size, usage=usage, format="rgba32float")
            if is_written:
                textures[image] = texture, size
            else:
                assert given[image].shape == (size[1], size[0], 4), image
                self.device.queue.write_texture(
                    {"texture": texture},
                    np.ascontiguousarray(given[image], np.float32),
                    {"bytes_per_row": 16 * size[0], "rows_per_image": size[1]},
                    size,
                )
            entries.append({"binding": number, "resource": texture.create_view()})
        pipeline = self._get_pipeline(each)
        groups = [-(-constants[side] // count) for side, count in zip(each.extent, WORKGROUP, strict=True)]
        dispatch(self.device, pipeline, self._layouts[name], entries, groups)
        return {image: self._read(*texture) for image, texture in textures.items()}

    def _read(self, texture: Any, size: tuple[int, int, int]) -> FloatArray:
        layout = {"bytes_per_row": 16 * size[0], "rows_per_image": size[1]}
        raw = self.device.queue.read_texture({"texture": texture}, layout, size)
        return np.frombuffer(raw, np.float32).reshape(size[1], size[0], 4).copy()

    def _get_pipeline(self, each: Pass) -> Any:
        """Return the compiled pass. Its layout is declared: a binding that a pass does not read stays in it."""
        import wgpu

        if each.name not in self._pipelines:
            code: str | bytes = write_pass(self.chain, each, self.language)
            if self.language != "wgsl":
                folder = self.folder / f"{self.chain.name}_{each.name}"
                folder.mkdir(exist_ok=True)
                code = compile_spirv(self.language, str(code), folder)
                written = [number for number, one in enumerate(self.chain.list_bindings(each), 1) if one.format]
                code = forbid_reading(code, written)
            module = self.device.create_shader_module(code=code)
            visible = wgpu.ShaderStage.COMPUTE
            entries: list[dict[str, Any]] = [{"binding": 0, "visibility": visible, "buffer": {"type": "uniform"}}]
            for number, binding in enumerate(self.chain.list_bindings(each), 1):
                read: dict[str, Any] = {"texture": {"sample_type": "unfilterable-float"}}
                written: dict[str, Any] = {"storage_texture": {"access": "write-only", "format": binding.format}}
                entries.append(
                    {"binding": number, "visibility": visible, **(read if binding.format is None else written)}
                )
            layout = self.device.create_bind_group_layout(entries=entries)
            whole = self.device.create_pipeline_layout(bind_group_layouts=[layout])
            stage = {"module": module, "entry_point": "main"}
            self._layouts[each.name] = layout
            self._pipelines[each.name] = self.device.create_compute_pipeline(layout=whole, compute=stage)
        return self._pipelines[each.name]
