"""Results on the bundled frame, bit by bit: what a change that should change no picture is held against."""
