"""The public names for users of Mitsuba; each module is imported when one of its names is first used."""

from .denoiser import Denoiser as Denoiser
from .integrator import denoise as denoise
from .integrator import register_integrator as register_integrator
