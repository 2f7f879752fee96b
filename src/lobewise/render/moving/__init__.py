"""Objects that move: places of shapes in a loaded scene, and files that list these places."""
