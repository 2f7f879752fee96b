"""Plans: which steps make a result, in which order, as frozen records that can be printed."""
