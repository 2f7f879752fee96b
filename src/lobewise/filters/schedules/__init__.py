"""How the filters are computed, per device."""
