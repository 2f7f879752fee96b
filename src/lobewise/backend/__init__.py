"""Compile, cache and call kernels; lend images to devices. Only this package uses Halide's runtime."""
