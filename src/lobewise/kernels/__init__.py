"""Image kernels, the only importer of Halide."""
