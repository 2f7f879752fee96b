"""Sequences that nothing was tuned on: error, flicker and ghosts, frame by frame and with windows in time."""
