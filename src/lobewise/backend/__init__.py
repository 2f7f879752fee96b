"""Kernels compiled, kept, called; images and devices: the only room that knows Halide's runtime."""
