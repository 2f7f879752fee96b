"""The figures of docs/results.md and docs/research/hit_distance.md."""

from __future__ import annotations

from typing import Any

from benchmarks.pages.tables import describe_run, list_facts, make_table
from benchmarks.pages.upsampling import make_upsampling_figures

COLUMNS = ("noisy", "normal", "band-limited", "sg", "sg_mixture", "asg", "ggx", "oidn")
TITLES = {
    "noisy": "noisy",
    "normal": "normal-aware, tuned",
    "band-limited": "band-limited, tuned",
    "sg": "`sg`",
    "sg_mixture": "`sg_mixture`",
    "asg": "`asg`",
    "ggx": "`ggx`",
    "oidn": "Open Image Denoise",
}


TIMED = ("normal", "sg", "sg_mixture, 3 lobes", "sg_mixture, 3 coaxial", "asg", "ggx")
"""Names in filters.json and paper_table.json."""


def make_error_table(similarities: dict[str, Any], key: str, samples: list[str]) -> str:
    """Return the errors ``key`` of every scene at the sample counts ``samples``."""
    rows = []
    for scene, by_spp in similarities["scenes"].items():
        for spp in samples:
            row = by_spp[spp]
            cells = []
            for name in COLUMNS:
                best = f"{name} (for specular)"
                source = row[best] if key == "rel_mse_specular" and best in row else row.get(name)
                cells.append("" if source is None else f"{source[key]:.4f}")
            rows.append([scene, spp, *cells])
    return make_table(["scene", "spp", *(TITLES[name] for name in COLUMNS)], rows)


def make_ratio_table(similarities: dict[str, Any]) -> str:
    """Return the default's error over that of the tuned baseline and over the neural peer's."""
    rows = []
    for scene, by_spp in similarities["scenes"].items():
        for spp, row in by_spp.items():
            cells = [
                f"{row['default_over_normal']:.2f}",
                f"{row['default_over_normal_specular']:.2f}",
                f"{row['default']['rel_mse'] / row['band-limited']['rel_mse']:.2f}",
                f"{row['default']['rel_mse'] / row['oidn']['rel_mse']:.2f}" if "oidn" in row else "",
            ]
            rows.append([scene, spp, *cells])
    header = [
        "scene",
        "spp",
        "over normal-aware",
        "over normal-aware, specular pixels",
        "over band-limited",
        "over OIDN",
    ]
    return make_table(header, rows)


def make_anisotropic_table(similarities: dict[str, Any]) -> str:
    """Return the errors on the anisotropic pixels, and how much lower than `sg` the anisotropic lobes are."""
    rows = []
    for scene, by_spp in similarities["scenes"].items():
        for spp, row in by_spp.items():
            if "rel_mse_anisotropic" not in row["sg"]:
                continue
            errors = [row[name]["rel_mse_anisotropic"] for name in ("sg", "sg_mixture", "asg", "ggx")]
            gains = [f"{100.0 * (1.0 - error / errors[0]):.0f} %" for error in errors[2:]]
            rows.append([scene, spp, *(f"{error:.4f}" for error in errors), *gains])
    header = ["scene", "spp", "`sg`", "`sg_mixture`", "`asg`", "`ggx`", "`asg` below `sg`", "`ggx` below `sg`"]
    return make_table(header, rows)


def make_hit_tables(similarities: dict[str, Any], hits: dict[str, Any]) -> tuple[str, str]:
    """Return what the hit-distance term does on the four scenes, and on the one made for it."""
    names = ("sg", "asg", "ggx")
    rows = []
    for scene, by_spp in similarities["scenes"].items():
        for spp, row in by_spp.items():
            ratios = [row[f"{name} with hits"]["rel_mse"] / row[name]["rel_mse"] for name in names]
            rows.append([scene, spp, *(f"{ratio:.2f}" for ratio in ratios)])
    header = [f"`{name}` with over without" for name in names]
    scenes = make_table(["scene", "spp", *header], rows)
    rows = []
    for spp, row in hits["samples"].items():
        for name in names:
            cells = []
            for key, tuned in (("rel_mse", "tuned"), ("rel_mse_contacts", "tuned for contacts")):
                for kind in ("default", tuned):
                    without, with_hits = row[name][kind][key], row[f"{name} with hits"][kind][key]
                    cells.append(f"{without:.5f}, {with_hits:.5f}")
            rows.append([spp, f"`{name}`", *cells])
    columns = ["image, default", "image, tuned", "contacts, default", "contacts, tuned"]
    return scenes, make_table(["spp", "similarity", *columns], rows)


def make_paper_table(paper: dict[str, Any]) -> str:
    """Return our times and ratios beside the paper's."""
    rows = []
    for row in paper["rows"]:
        for name, cell in row["similarities"].items():
            theirs = f"{cell['paper_ratio_to_normal']:.2f}" if "paper_ratio_to_normal" in cell else ""
            cells = [f"{cell['milliseconds']:.1f} ms", f"{cell['ratio_to_normal']:.2f}", theirs]
            rows.append([row["form"], str(row["radius"]), f"`{name}`", *cells])
    return make_table(["form", "radius", "similarity", "time", "ratio to normal", "the paper's ratio"], rows)


def make_time_tables(filters: dict[str, Any]) -> dict[str, str]:
    """Return the times of kernels, and the times beside Open Image Denoise."""
    rows = []
    for row in filters["kernels"]:
        cells = [f"{row['width']}x{row['height']}", row["form"], str(row["radius"])]
        for name in TIMED:
            cells.append(f"{row[name]['milliseconds']:.1f} ms ({row[name]['ratio_to_normal']:.2f})")
        cells.append(f"{row['normal']['ns_per_tap_and_pixel']:.3f}")
        rows.append(cells)
    kernels = make_table(["size", "form", "radius", *TIMED, "normal, ns per tap and pixel"], rows)
    rows = [
        [size, name, f"{cell['milliseconds']:.0f} ms", f"{cell['times_faster_than_oidn']:.1f}"]
        for size, cells in filters["oidn"].items()
        for name, cell in cells.items()
    ]
    peer = make_table(["size", "what", "time", "times faster than OIDN"], rows)
    return {"kernels": kernels, "peer": peer, "kernels-run": list_facts({"Machine": describe_run(filters)})}


def make_hit_figures(similarities: dict[str, Any], hits: dict[str, Any]) -> dict[str, str]:
    """Return the figures of docs/research/hit_distance.md by place."""
    scenes, contacts = make_hit_tables(similarities, hits)
    run = {
        "Size": f"{hits['size']}x{hits['size']}",
        "Samples per pixel of the reference": hits["reference_spp"],
        "Settings of beta and screen sigma that were tried": len(hits["factors"]) ** 2,
        "Machine": describe_run(hits),
    }
    return {"scenes": scenes, "contacts-run": list_facts(run), "contacts": contacts}


def make_figures(
    similarities: dict[str, Any], filters: dict[str, Any], paper: dict[str, Any], upsampling: dict[str, Any]
) -> dict[str, str]:
    """Return the figures of docs/results.md by place."""
    every = list(next(iter(similarities["scenes"].values())))
    grid = {name: len(values) for name, values in similarities["grid"].items()}
    run = {
        "Size": f"{similarities['size']}x{similarities['size']}",
        "Samples per pixel of the references": similarities["reference_spp"],
        "Settings tried for the normal-aware baseline": (
            f"{grid['normal_exponent']} exponents times {grid['screen_sigma']} screen sigmas"
        ),
        "Settings tried for the band-limited baseline": (
            f"{grid['band_limited_normal_exponent']} exponents times {grid['band_limited_screen_sigma']} screen sigmas "
            f"times {grid['band_limit']} band-limits"
        ),
        "Machine": describe_run(similarities),
    }
    return {
        "run": list_facts(run),
        "errors": make_error_table(similarities, "rel_mse", every),
        "specular": make_error_table(similarities, "rel_mse_specular", every),
        "ratios": make_ratio_table(similarities),
        "anisotropic": make_anisotropic_table(similarities),
        **make_upsampling_figures(upsampling),
        "paper-run": list_facts({"Machine": describe_run(paper)}),
        "paper": make_paper_table(paper),
        **make_time_tables(filters),
    }
