"""Protection of the page: who may open it, and which messages a browser may send."""
