"""Estimates of the noise of an image, and of the error of a filtered image."""
