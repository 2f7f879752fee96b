"""What a call is while it runs: pieces of its work, its progress, its limits."""
