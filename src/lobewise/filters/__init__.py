"""The image filters: kernels, each with its algorithm and its schedules, and the functions that call them."""
