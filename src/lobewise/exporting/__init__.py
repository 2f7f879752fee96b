"""The filters for other people's programs: compiled ahead of time with a C interface, or as shader text."""
