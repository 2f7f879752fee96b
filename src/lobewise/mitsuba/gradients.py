"""Gradients through a denoiser whose weights are fixed: a linear map, whose adjoint is exact."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from lobewise.denoising.linear import LinearFilter
from lobewise.frame import FloatArray
from lobewise.mitsuba.tensors import give_back, to_array


@dataclass(frozen=True)
class LinearImage:
    """What a denoiser does to an image, (height, width, channels), as a linear map.

    Parameters
    ----------
    color : LinearFilter
        Of the first channels.
    alpha : LinearFilter or None
        Of the last one, where there is one; None copies it.
    count : int
        Channels that are colour: 3, or 1 of a monochrome image.
    """

    color: LinearFilter
    alpha: LinearFilter | None
    count: int

    def apply(self, image: FloatArray) -> FloatArray:
        """Return the denoised image."""
        return self._join(image, transposed=False)

    def transpose(self, gradient: FloatArray) -> FloatArray:
        """Return the adjoint: what a gradient of the denoised image is one of the noisy image."""
        return self._join(gradient, transposed=True)

    def _join(self, image: FloatArray, *, transposed: bool) -> FloatArray:
        def run(linear: LinearFilter, part: FloatArray) -> FloatArray:
            wide = part if part.shape[2] == 3 else np.repeat(part, 3, axis=-1)
            found = linear.transpose(wide) if transposed else linear.apply(wide)
            return found[..., : part.shape[2]]

        color, alpha = image[..., : self.count], image[..., self.count :]
        if self.alpha is not None and alpha.shape[2]:
            alpha = run(self.alpha, alpha)
        return np.concatenate([run(self.color, color), alpha], axis=-1)


def apply_differentiably(noisy: Any, linear: LinearImage) -> Any:
    """Return a denoised tensor through which gradients pass, forwards and backwards."""
    from lobewise.render.bridge import dr

    class Denoise(dr.CustomOp):  # type: ignore[misc]  # Dr.Jit is untyped here
        """The filter as an operation of Dr.Jit's."""

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
