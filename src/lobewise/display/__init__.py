"""Pictures for people: tone mapping, and cards for notebooks."""
