"""The plan of a frame as a C library: its kernels compiled ahead of time, and a C program that runs them in order."""
