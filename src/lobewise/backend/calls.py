"""A kernel run on whole images: lent to its device, sizes read off them, what it writes returned by name."""

from __future__ import annotations

from collections.abc import Mapping

from lobewise.backend.buffers import Image, lend, make_output
from lobewise.backend.jit import Kernel


def run_kernel(kernel: Kernel, device: str, images: Mapping[str, Image], **numbers: float) -> dict[str, Image]:
    """Run a kernel and return what it writes, in the order of its signature.

    Parameters
    ----------
    kernel : Kernel
        All sizes of its outputs are also sizes of its inputs.
    device : str
        Its device.
    images : mapping of str to Image
        What it reads, by name; see `lobewise.backend.buffers.take_image`.
    **numbers
        Likewise.

    Raises
    ------
    TypeError
        If a name is missing or unknown, or an image is not of the type, size or layout that the kernel relies on.
    DeviceError
        If the device fails, or has no memory.
    """
    sizes = {
        axis: length
        for each in kernel.parameters
        if each.role == "input" and each.name in images
        for axis, length in zip(each.axes, images[each.name].shape, strict=False)
        if isinstance(axis, str)
    }
    # Every buffer is held in a local name until the call has returned: Halide keeps no reference.
    lent = {name: lend(image, device) for name, image in images.items()}
    types = {each.name: each.type for each in kernel.outputs}
    outputs = {
        name: make_output(shape, device, type=types[name]) for name, shape in kernel.list_shapes(**sizes).items()
    }
    kernel(**lent, **numbers, **{name: buffer for name, (buffer, _) in outputs.items()})
    return {name: image for name, (_, image) in outputs.items()}
