"""A pipeline as data: images, numbers, calls of kernels, and memory."""
