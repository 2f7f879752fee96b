"""Looks at the machine: what lobewise needs, what it found, and what to do about each problem."""
