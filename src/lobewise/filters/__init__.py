"""The image filters as algorithms; `schedules` says how processors and graphics cards compute them."""
