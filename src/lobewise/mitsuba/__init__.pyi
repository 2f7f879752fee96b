"""The public names for users of Mitsuba; each module is imported when one of its names is first used."""

from .denoiser import Denoiser as Denoiser
from .scenes import denoise as denoise
