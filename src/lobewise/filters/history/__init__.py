"""What pixels remember from frame to frame: reprojection of their history, and accumulation of samples into it."""
