"""Files of other renderers: what their channels mean, frames made of them, results put back where they came from."""
