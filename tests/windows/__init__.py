"""Windows in time."""
