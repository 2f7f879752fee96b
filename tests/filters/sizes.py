"""Sizes of images that Hypothesis draws for the properties of kernels."""

from hypothesis import strategies as st

MAX_SIDE = 70
"""Several vectors of the widest processors, and more than a strip of rows."""
SIZES = st.tuples(st.integers(1, MAX_SIDE), st.integers(1, MAX_SIDE))
"""Height and width in pixels."""
SMALL_SIZES = st.tuples(st.integers(1, 17), st.integers(1, 33))
"""Of images whose oracle goes from pixel to pixel in Python."""
