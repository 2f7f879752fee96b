"""Indirect light by cones through voxels."""
