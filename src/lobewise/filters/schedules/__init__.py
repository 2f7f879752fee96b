"""Schedules of the kernels: how they are computed on processors and on graphics cards."""
