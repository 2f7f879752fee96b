"""The recipes of this package as steps of a pipeline."""
