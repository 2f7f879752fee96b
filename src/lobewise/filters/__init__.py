"""The algorithms on images; how they are computed is in `schedules`."""
