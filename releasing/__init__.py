"""Programs that make a release: kernels compiled ahead of time, wheels, and the measurement of an installed wheel."""
