"""What a chain contains, as lines for people: inputs, results, memory and passes."""

from __future__ import annotations

from collections.abc import Iterator

from lobewise.exporting.shaders.passes import Chain, Lifetime

BYTES = {"rgba32float": 16, "rgba16float": 8}
"""Bytes of a pixel, by format."""


def count_bytes(chain: Chain) -> tuple[int, int]:
    """Return the bytes of each pixel that images take within a frame, at most at once, and from frame to frame.

    Images of lifetime "frame" may share memory once no later pass reads them. Samples count as pixels.
    """
    state = [image for image in chain.images if image.lifetime in (Lifetime.KEPT, Lifetime.BEFORE)]
    last_reader = {
        image: number for number, shader_pass in enumerate(chain.passes) for image in shader_pass.reads.values()
    }
    alive: set[str] = set()
    most = 0
    for number, shader_pass in enumerate(chain.passes):
        written = [chain.get_image(name) for name in shader_pass.writes.values()]
        alive |= {image.name for image in written if image.lifetime is Lifetime.FRAME}
        most = max(most, sum(BYTES[chain.get_image(name).format] for name in alive))
        alive = {name for name in alive if last_reader.get(name, -1) > number}
    return most, sum(BYTES[image.format] for image in state)


def list_chain(chain: Chain, language: str) -> Iterator[str]:
    """Yield lines that say what a chain contains."""
    yield f"lobewise chain {chain.name} in {language}. {chain.comment}"
    for title, lifetime in (("Inputs", Lifetime.GIVEN), ("Results", Lifetime.RESULT)):
        yield f"{title}:"
        for image in chain.images:
            if image.lifetime is lifetime:
                yield f"  {image.name}: {image.extent[0]} x {image.extent[1]}, {image.comment}"
    within, between = count_bytes(chain)
    memory = f"{within} bytes for each pixel within a frame, {between} from frame to frame"
    yield f"Memory: {memory}, beside inputs and result."
    yield f"Passes: {len(chain.passes)}."
    for number, shader_pass in enumerate(chain.passes, 1):
        reads, writes = (
            ", ".join(dict.fromkeys(images.values())) for images in (shader_pass.reads, shader_pass.writes)
        )
        yield f"{number}. {shader_pass.name}: {reads} -> {writes}"
