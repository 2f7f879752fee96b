"""The door of the page: who may come in, and what a browser that is in may send."""
