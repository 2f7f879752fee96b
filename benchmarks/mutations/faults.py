"""The faults that the tests must see: 47 ways to break the product that users would suffer from.

Each fault replaces one text of one file. None breaks an import, and each changes what a user gets.
"""

from typing import NamedTuple


class Mutation(NamedTuple):
    """One fault.

    Parameters
    ----------
    name : str
        What is wrong, in plain words.
    file : str
        Path below ``src/lobewise``.
    old, new : str
        The text that is replaced, which the file holds exactly once, and what replaces it.
    tests : tuple of str
        Files and folders below ``tests`` that should see the fault first.
    """

    name: str
    file: str
    old: str
    new: str
    tests: tuple[str, ...]


LOBES = (
    Mutation(
        "single lobes are too narrow by a factor of 2",
        "lobes/gaussian.py",
        "warp = 2.0 * xp.maximum(cosine",
        "warp = xp.maximum(cosine",
        ("guides/test_lobe_fields.py", "lobes/test_sg.py"),
    ),
    Mutation(
        "distances of hits are compared with the nearer one",
        "features/seen.py",
        "largest = hl.max(i.inverse_distance",
        "largest = hl.min(i.inverse_distance",
        ("features/test_similarity.py",),
    ),
    Mutation(
        "brushed metal is brushed across instead of along",
        "lobes/roughness.py",
        "return xp.maximum(xp.number(MIN_ALPHA), square / aspect), xp.maximum(xp.number(MIN_ALPHA), square * aspect)",
        "return xp.maximum(xp.number(MIN_ALPHA), square * aspect), xp.maximum(xp.number(MIN_ALPHA), square / aspect)",
        ("lobes/test_roughness.py", "interchange/test_conventions.py"),
    ),
    Mutation(
        "beta is left out of the widths of spherical Gaussians",
        "features/sg.py",
        "- parameters[0] * log2(width) -",
        "- log2(width) -",
        ("features/test_similarity.py", "lobes/test_sg.py"),
    ),
    Mutation(
        "GGX lobes are compared as if their covariances were added the wrong way",
        "features/ggx.py",
        "* dot(d, d) - (on_i * on_i + on_j * on_j)",
        "* dot(d, d) + (on_i * on_i + on_j * on_j)",
        ("features/test_similarity.py", "lobes/test_tangent.py"),
    ),
)

FILTERS = (
    Mutation(
        "the albedo is not multiplied back",
        "filters/cross_pass.py",
        "tints = [hl.select(expressions.is_bad(tint), hl.f32(0.0), tint) for tint in tints]",
        "tints = [hl.f32(1.0) for tint in tints]",
        ("filters/test_cross_filter.py", "filters/test_upsampling.py"),
    ),
    Mutation(
        "the lowest row of a kernel's taps is left out",
        "filters/weigh.py",
        "outer = hl.RDom(span if self",
        "outer = hl.RDom([(-self._reach, 2 * self._reach)] if self",
        ("filters/test_cross_filter.py", "filters/test_expected.py"),
    ),
    Mutation(
        "a half without samples becomes black instead of taking the other half",
        "filters/dual_buffer.py",
        "means[half][k], means[1 - half][k])",
        "means[half][k], means[half][k])",
        ("filters/test_dual_buffer.py", "denoising/test_quality_modes.py"),
    ),
    Mutation(
        "a second firefly in the window lifts the bound of the first",
        "filters/fireflies.py",
        "bound = hl.max(others.second, hl.f32(0.0))",
        "bound = hl.max(others.largest, hl.f32(0.0))",
        ("filters/test_fireflies.py", "denoising/test_light_loss.py"),
    ),
    Mutation(
        "highlights lose 1 % of their light",
        "filters/highlights.py",
        "hl.select(part > zero, mean * part, zero)])",
        "hl.select(part > zero, mean * part * hl.f32(0.99), zero)])",
        ("filters/test_highlights.py", "denoising/test_high.py"),
    ),
    Mutation(
        "specks lose the light that no neighbour takes",
        "filters/specks.py",
        "total = bright - share * taken + takes",
        "total = kept + takes",
        ("filters/test_specks.py", "interchange/test_unscattered.py"),
    ),
    Mutation(
        "the noise of a mean of two halves counts as twice its variance",
        "filters/noise/pooling.py",
        "squares = [hl.f32(0.25) * (p - q) * (p - q)",
        "squares = [hl.f32(0.5) * (p - q) * (p - q)",
        ("filters/test_evidence.py", "filters/test_detail.py"),
    ),
)

DENOISING = (
    Mutation(
        "the shares of our image and of the noisy image are swapped",
        "denoising/combining.py",
        "mixed = peer + shares[..., :1] * (ours - peer) + shares[..., 1:2] * (noisy - peer)",
        "mixed = peer + shares[..., 1:2] * (ours - peer) + shares[..., :1] * (noisy - peer)",
        ("denoising/test_auto.py", "denoising/test_high.py"),
    ),
    Mutation(
        "a light group that is not finite at a pixel stays so",
        "filters/glue.py",
        "select_bits(is_finite(value) & is_mixed, value, part)",
        "select_bits(is_mixed, value, part)",
        ("denoising/test_also.py",),
    ),
    Mutation(
        "light below 0 is added instead of subtracted",
        "records/result.py",
        "image=self.image - other.image,",
        "image=self.image + other.image,",
        ("denoising/test_negative.py", "streaming/test_recipe.py"),
    ),
    Mutation(
        "the light of fireflies is given back to the image and not to its parts",
        "denoising/light_loss.py",
        'bright.append(brighten(part, part, mask, gain, name="part"))',
        "bright.append(part)",
        ("denoising/test_light_loss.py", "denoising/test_also.py"),
    ),
    Mutation(
        "transmitted light is filtered like a reflection",
        "denoising/layers.py",
        "*(scattered if own.is_diffuse else transmitted if own.is_transmitted else reflected),",
        "*(scattered if own.is_diffuse else reflected),",
        ("denoising/test_quality_modes.py",),
    ),
    Mutation(
        "a pixel whose blue is no number counts as good",
        "denoising/bad_pixels.py",
        "& good_channels[..., 1] & good_channels[..., 2]",
        "& good_channels[..., 1]",
        ("denoising/test_unusable.py",),
    ),
    Mutation(
        "holes are filled with a mean that counts bad pixels",
        "denoising/bad_pixels.py",
        "np.count_nonzero(good, axis=1)[:, None]]",
        "np.full((len(good), 1), good.shape[1])]",
        ("denoising/test_unusable.py",),
    ),
    Mutation(
        "gray light on coloured surfaces becomes gray",
        "peers.py",
        '_is_gray(color) and _is_gray(given.get("albedo", color))',
        "_is_gray(color)",
        ("test_peers.py",),
    ),
    Mutation(
        "Open Image Denoise works on after a cancel",
        "peers.py",
        "return not is_cancelled.is_set()",
        "return True",
        ("test_progress.py",),
    ),
    Mutation(
        "the share of a call falls",
        "work/progress/__init__.py",
        "self.share = max(self.share, span.locate(inside[0]))",
        "self.share = span.locate(inside[0])",
        ("test_progress.py",),
    ),
)

GUIDES = (
    Mutation(
        "a firefly beside a lamp counts as the edge of the lamp",
        "guides/lamps.py",
        "(brightest > 0.0) & (radiance <= MAX_EDGE_EXCESS * brightest) & ~lamps",
        "(brightest > 0.0) & ~lamps",
        ("guides/test_lamps.py", "interchange/test_lamps.py"),
    ),
    Mutation(
        "distances along rays are taken for depths along the camera's axis",
        "guides/surfaces.py",
        'along = hl.f64(grid.read_one("depth")) / hl.sqrt(dot(ray, ray))',
        'along = hl.f64(grid.read_one("depth"))',
        ("guides/test_guides.py", "guides/test_places.py"),
    ),
    Mutation(
        "normals that stand in for missing ones face away from the camera",
        "guides/stand_ins.py",
        "compute_normals(across, down, -view)",
        "compute_normals(across, down, view)",
        ("guides/test_guides.py", "guides/test_survey.py"),
    ),
)

INTERCHANGE = (
    Mutation(
        "normals in camera space are turned to the back",
        "interchange/values.py",
        "np.stack([camera.right, camera.up, sign * camera.forward])",
        "np.stack([camera.right, camera.up, -sign * camera.forward])",
        ("interchange/test_cameras.py",),
    ),
    Mutation(
        "light that a renderer stores without its colour stays without it",
        "interchange/lighting.py",
        "factor = albedo if layer_pass.rule.times_albedo else None",
        "factor = None",
        ("interchange/test_replacing.py", "interchange/test_summary.py"),
    ),
    Mutation(
        "the right eye of a stereo file is taken for the left one",
        "interchange/channels.py",
        "view = view or part.view or views[0]",
        "view = view or views[0]",
        ("interchange/test_views.py",),
    ),
    Mutation(
        "a roughness above 1 is clamped and nobody is told",
        "interchange/checks/roughness.py",
        "if high <= 1.0 + MAX_ROUNDING_ERROR and low",
        "if high <= 1.0 + MAX_ROUNDING_ERROR or low",
        ("interchange/test_conventions.py", "interchange/test_contradictions.py"),
    ),
)

FILES = (
    Mutation(
        "images whose rows do not lie one after the other are written scrambled",
        "io/exr/pixels.py",
        "OpenEXR.Channel(name, np.ascontiguousarray(values), 1, 1",
        "OpenEXR.Channel(name, values, 1, 1",
        ("io/test_exr.py", "io/test_writers.py"),
    ),
    Mutation(
        "a lock that another process holds is granted again",
        "io/locks.py",
        "except BlockingIOError:\n            return False",
        "except BlockingIOError:\n            return True",
        ("io/test_locks.py", "farm/test_two_runs.py"),
    ),
    Mutation(
        "a sequence goes on over a missing frame as if it were there",
        "recipes/sequence.py",
        "shots = (cut_shots if remembers else cut_frames)(frames)",
        "shots = [frames]",
        ("cli/test_sequence.py", "io/test_sequence.py"),
    ),
    Mutation(
        "a file has its name before its content is on the disk",
        "io/replacing.py",
        "        os.fsync(self.stream.fileno())\n",
        "",
        ("io/test_targets.py",),
    ),
)

OVER_TIME = (
    Mutation(
        "motion vectors are followed the wrong way",
        "recipes/temporal/past.py",
        "return _Places(add_grid(motion)), None",
        "return _Places(add_grid(-motion)), None",
        ("temporal/test_recipe.py", "temporal/test_past.py"),
    ),
    Mutation(
        "windows lose the light that is in no layer",
        "recipes/windows/layers.py",
        "np.maximum(light.color - np.sum(before, axis=0) + np.sum(after, axis=0), np.float32(0.0))",
        "np.maximum(np.sum(after, axis=0), np.float32(0.0))",
        ("windows/test_windows.py",),
    ),
    Mutation(
        "rows and columns of the shaded pixels are swapped",
        "records/sparse_frame.py",
        "return slice(self.place[0], None, self.scale), slice(self.place[1], None, self.scale)",
        "return slice(self.place[1], None, self.scale), slice(self.place[0], None, self.scale)",
        ("denoising/test_upsampling.py", "filters/test_upsampling.py"),
    ),
    Mutation(
        "bands of rows begin where the network's blocks do not",
        "recipes/streaming/plan.py",
        "max(band[0] - reach, 0) // MULTIPLE * MULTIPLE",
        "max(band[0] - reach, 0)",
        ("streaming/test_bands.py", "streaming/test_recipe.py"),
    ),
    Mutation(
        "a cut keeps what is left of the history",
        "recipes/temporal/past.py",
        'engine.compare(self.share, ">=", temporal.cut_share)',
        'engine.compare(self.share, ">=", 0.0)',
        ("temporal/test_recipe.py",),
    ),
)

EXPORTING = (
    Mutation(
        "shaders read the row of the shaded pixel as its column",
        "exporting/shaders/constants.py",
        '"column": place[1],',
        '"column": place[0],',
        ("exporting/test_chains_upsample.py",),
    ),
    Mutation(
        "exported pipelines forget the light of highlights",
        "filters/glue.py",
        "select_bits(lit, value + highlight, value)",
        "select_bits(lit, value, value)",
        ("exporting/test_pipeline_balanced.py", "exporting/test_pipeline.py"),
    ),
)

RENDERING = (
    Mutation(
        "depths begin at the near plane instead of the camera",
        "render/gbuffer.py",
        '"depth": dr.select(is_hit, dr.norm(si.p - eye), 0.0)',
        '"depth": dr.select(is_hit, si.t, 0.0)',
        ("render/test_gbuffer.py",),
    ),
    Mutation(
        "the angle of view is given to the renderer in radians instead of degrees",
        "render/camera.py",
        'parameters["x_fov"] = float(np.rad2deg(2.0 * np.arctan(whole)))',
        'parameters["x_fov"] = float(2.0 * np.arctan(whole))',
        ("render/test_camera_path.py", "render/test_sequence.py"),
    ),
)

FRONTENDS = (
    Mutation(
        "a mistake of the user ends the command with the exit code of a bug",
        "cli/program.py",
        "return _fail(name_option(problem, arguments), EXIT_USER_ERROR, debug)",
        "return _fail(name_option(problem, arguments), EXIT_INTERNAL_ERROR, debug)",
        ("cli/test_overwriting.py", "cli/test_mistakes.py"),
    ),
    Mutation(
        "histories are forgotten ten times as fast by default",
        "settings/__init__.py",
        "] = 0.95",
        "] = 0.5",
        ("temporal/test_recipe.py", "test_settings.py"),
    ),
    Mutation(
        "the viewer's camera moves in the browser's unit instead of the scene's",
        "viewer/cameras.py",
        "return Camera(position=pose.position / self._scale, forward",
        "return Camera(position=pose.position, forward",
        ("viewer/test_cameras.py",),
    ),
    Mutation(
        "a farm takes a frame of other settings for done",
        "recipes/ledger.py",
        'and record.get("proof") == proof',
        'and isinstance(record.get("proof"), str)',
        ("farm/test_ledger.py",),
    ),
    Mutation(
        "flicker is halved",
        "metrics/sequences.py",
        "(0.5 * (r**2 + before[1] ** 2) + EPSILON)",
        "(r**2 + before[1] ** 2 + EPSILON)",
        ("metrics/test_metrics.py",),
    ),
)

MUTATIONS = (
    *LOBES,
    *FILTERS,
    *DENOISING,
    *GUIDES,
    *INTERCHANGE,
    *FILES,
    *OVER_TIME,
    *EXPORTING,
    *RENDERING,
    *FRONTENDS,
)
