"""Files of Mitsuba's ``measured`` plugin (Dupuy and Jakob 2018), made from a formula."""

import struct
from pathlib import Path

import numpy as np

_TYPES = {np.dtype("u1"): 1, np.dtype("f4"): 10}


def write_measured(path: Path, alpha: float, color: tuple[float, float, float]) -> None:
    """Write a material of ``brdf cos = color D(half) / 4``, D being the normals of isotropic GGX."""
    # The angle of the half vector is spaced evenly in its root.
    theta = np.linspace(0.0, 1.0, 256) ** 2 * (0.5 * np.pi)
    normals = 1.0 / (np.pi * alpha**2 * (np.cos(theta) ** 2 + (np.sin(theta) / alpha) ** 2) ** 2)
    angles = np.linspace(0.0, 1.5, 6)
    grid = np.ones((1, angles.size, 8, 8))
    fields = {
        "description": np.frombuffer(b"made from a formula", dtype="u1"),
        "phi_i": np.zeros(1, "f4"),
        "theta_i": angles.astype("f4"),
        "ndf": np.tile(normals, (2, 1)).astype("f4"),
        "sigma": np.ones((2, 8), "f4"),
        "vndf": grid.astype("f4"),
        "luminance": grid.astype("f4"),
        "rgb": (grid[:, :, None] * np.reshape(color, (3, 1, 1))).astype("f4"),
        "jacobian": np.ones(1, "u1"),
    }
    start = 18 + sum(13 + len(name) + 8 * array.ndim for name, array in fields.items())
    head, body = b"tensor_file\0" + struct.pack("<2BI", 1, 0, len(fields)), b""
    for name, array in fields.items():
        head += struct.pack("<H", len(name)) + name.encode()
        head += struct.pack("<HBQ", array.ndim, _TYPES[array.dtype], start + len(body))
        head += struct.pack(f"<{array.ndim}Q", *array.shape)
        body += array.tobytes()
    path.write_bytes(head + body)
