"""What makes two pixels similar: a distribution per pixel, one file each."""
