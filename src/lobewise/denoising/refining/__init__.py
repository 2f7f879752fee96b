"""Refining: a network weighs the neighbours of every pixel anew, after the layers of a frame are filtered.

The network reads the noisy and the filtered light of all layers together. The layers keep their shares of the light.
"""
