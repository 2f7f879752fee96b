"""Help, progress and summaries on a terminal, in words that need no knowledge of how lobewise works."""
