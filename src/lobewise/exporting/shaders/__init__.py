"""The filter as shader text in three languages: single functions, and complete chains of compute passes."""
