"""What makes the figures and pictures of the docs, and their tests; run from the checkout, as modules."""
