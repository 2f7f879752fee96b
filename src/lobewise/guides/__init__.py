"""Inputs of the filters, computed from a frame: surfaces, lobes, places in the previous frame, halves."""
