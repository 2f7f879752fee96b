"""How noisy an image is, and what that says of a result."""
