"""A foreign file becomes a frame: a list of small steps, each of which reads, converts or checks one thing."""
