"""The history of pixels over frames: reproject it, and accumulate samples into it."""
