"""Second, independent definitions in NumPy, mostly float64: tests compare the package with them."""
