"""Pages, plots and pictures that people look at."""
