"""Kernels that bring the samples of other frames to the pixels of a frame, and weigh them."""
