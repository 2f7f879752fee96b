"""Indirect light by virtual lights."""
