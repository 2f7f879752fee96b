"""Gradients through a denoiser with fixed weights. Such a denoiser is a linear map, so its adjoint is exact."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from lobewise.mitsuba.linear import LinearFilter
from lobewise.mitsuba.tensors import give_back, to_array
from lobewise.records.frame import FloatArray


@dataclass(frozen=True)
class LinearImage:
    """A denoiser as a linear map of images, (height, width, channels).

    Parameters
    ----------
    color : LinearFilter
        Filter of the color channels, which come first.
    alpha : LinearFilter or None
        Filter of the alpha channel, which comes last. None copies alpha.
    count : int
        Number of color channels: 3, or 1 in a monochrome image.
    """

    color: LinearFilter
    alpha: LinearFilter | None
    count: int

    def apply(self, image: FloatArray) -> FloatArray:
        """Return the denoised image."""
        return self._join(image, transposed=False)

    def transpose(self, gradient: FloatArray) -> FloatArray:
        """Return the gradient by the noisy image, from the gradient by the denoised image."""
        return self._join(gradient, transposed=True)

    def _join(self, image: FloatArray, *, transposed: bool) -> FloatArray:
        def run(linear: LinearFilter, part: FloatArray) -> FloatArray:
            wide = part if part.shape[2] == 3 else np.repeat(part, 3, axis=-1)
            filtered = linear.transpose(wide) if transposed else linear.apply(wide)
            return filtered[..., : part.shape[2]]

        color, alpha = image[..., : self.count], image[..., self.count :]
        if self.alpha is not None and alpha.shape[2]:
            alpha = run(self.alpha, alpha)
        return np.concatenate([run(self.color, color), alpha], axis=-1)


def apply_differentiably(noisy: Any, linear: LinearImage) -> Any:
    """Return a denoised tensor through which gradients pass, forwards and backwards."""
    from lobewise.render.bridge import dr

    class Denoise(dr.CustomOp):  # type: ignore[misc]  # Dr.Jit is untyped here
        """The filter as a Dr.Jit operation."""

        def eval(self, noisy: Any) -> Any:
            self.like = noisy
            return give_back(noisy, linear.apply(to_array("noisy", noisy)))

        def forward(self) -> None:
            tangent = to_array("gradient", self.grad_in("noisy"))
            self.set_grad_out(give_back(self.like, linear.apply(tangent)))

        def backward(self) -> None:
            gradient = to_array("gradient", self.grad_out())
            self.set_grad_in("noisy", give_back(self.like, linear.transpose(gradient)))

        def name(self) -> str:
            return "lobewise.mitsuba.Denoiser"

    return dr.custom(Denoise, noisy)
