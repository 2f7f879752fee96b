"""How surfaces reflect: Mitsuba's BSDFs opened, measured and fitted."""
