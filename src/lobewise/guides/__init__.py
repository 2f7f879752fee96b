"""What a frame knows before filtering: surfaces, lobes, places, halves."""
