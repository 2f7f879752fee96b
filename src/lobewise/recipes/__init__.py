"""The recipes beside that of one frame: upsampling, pixels again, histories, windows, bands, sequences."""
