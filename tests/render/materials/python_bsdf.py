"""BSDFs written in Python, as users would: lobes about the mirror direction that no plugin of Mitsuba has."""

from functools import lru_cache
from typing import Any

from lobewise.render import load_mitsuba


def register_lobes() -> str:
    """Register the plugin with the variant that is set, and return its name.

    Its lobes are powers of the cosine to the mirror direction: a sharp and a wide one, and with ``stretch`` above 1
    narrower across the tangent turned by ``turn`` radians. It heeds no context and says nothing of itself.
    """
    mi = load_mitsuba("cpu")
    import drjit as dr

    class Lobes(make_sampled_by_cosine()):  # type: ignore[misc]  # Mitsuba is untyped
        def __init__(self, props: Any) -> None:
            mi.BSDF.__init__(self, props)
            self.sharp, self.wide = props.get("sharp", 100.0), props.get("wide", 3.0)
            self.stretch, self.turn = props.get("stretch", 1.0), props.get("turn", 0.0)
            self.color = mi.ScalarColor3f(0.8, 0.5, 0.3)
            self.m_components = [mi.BSDFFlags.GlossyReflection | mi.BSDFFlags.FrontSide]
            self.m_flags = self.m_components[0]

        def eval(self, ctx: Any, si: Any, wo: Any, active: Any = True) -> Any:
            half = dr.normalize(si.wi + wo)
            x = half.x * dr.cos(self.turn) + half.y * dr.sin(self.turn)
            y = half.y * dr.cos(self.turn) - half.x * dr.sin(self.turn)
            bent = dr.square(x / self.stretch) + dr.square(y * self.stretch)
            value = dr.exp(-2.0 * self.sharp * bent) * (self.sharp + 1.0) * 0.7 + dr.exp(-2.0 * self.wide * bent) * 0.6
            lit = active & (si.wi.z > 0) & (wo.z > 0)
            return dr.select(lit, mi.Color3f(self.color) * (value * dr.inv_two_pi * wo.z), 0.0)

    mi.register_bsdf("lobewise_test_lobes", lambda props: Lobes(props))
    return "lobewise_test_lobes"


def register_rough() -> str:
    """Register a plugin of one lobe that says nothing of itself, and return its name.

    Its textures are ``rough``, the root mean square slope of the facets, ``stretch``, which makes the lobe longer along
    the tangent and shorter across it, and ``color``, its value.

    Source: Ward 1992, "Measuring and modeling anisotropic reflection". Departs: the cosines of view and light are left
    out of the denominator.
    """
    mi = load_mitsuba("cpu")
    import drjit as dr

    class Rough(make_sampled_by_cosine()):  # type: ignore[misc]  # Mitsuba is untyped
        def __init__(self, props: Any) -> None:
            mi.BSDF.__init__(self, props)
            self.rough, self.stretch = props.get_texture("rough", 0.2), props.get_texture("stretch", 1.0)
            self.color = props.get_texture("color", 0.8)
            self.m_components = [mi.BSDFFlags.GlossyReflection | mi.BSDFFlags.FrontSide]
            self.m_flags = self.m_components[0]

        def eval(self, ctx: Any, si: Any, wo: Any, active: Any = True) -> Any:
            half = dr.normalize(si.wi + wo)
            rough, stretch = self.rough.eval_1(si, active), self.stretch.eval_1(si, active)
            x, y = half.x / (half.z * rough * stretch), half.y * stretch / (half.z * rough)
            value = dr.exp(-dr.square(x) - dr.square(y)) / (4.0 * dr.pi * dr.square(rough))
            lit = active & (si.wi.z > 0) & (wo.z > 0)
            return dr.select(lit, self.color.eval(si, active) * (value * wo.z), 0.0)

    mi.register_bsdf("lobewise_test_rough", lambda props: Rough(props))
    return "lobewise_test_rough"


@lru_cache(maxsize=1)
def make_sampled_by_cosine() -> Any:
    """Return the base class of these plugins, whose samples are spread by the cosine."""
    mi = load_mitsuba("cpu")
    import drjit as dr

    class SampledByCosine(mi.BSDF):  # type: ignore[misc, name-defined]  # Mitsuba is untyped
        def pdf(self, ctx: Any, si: Any, wo: Any, active: Any = True) -> Any:
            lit = active & (si.wi.z > 0) & (wo.z > 0)
            return dr.select(lit, mi.warp.square_to_cosine_hemisphere_pdf(wo), 0.0)

        def eval_pdf(self, ctx: Any, si: Any, wo: Any, active: Any = True) -> Any:
            return self.eval(ctx, si, wo, active), self.pdf(ctx, si, wo, active)

        def sample(self, ctx: Any, si: Any, choice: Any, point: Any, active: Any = True) -> Any:
            found = dr.zeros(mi.BSDFSample3f)
            found.wo = mi.warp.square_to_cosine_hemisphere(point)
            found.pdf = mi.warp.square_to_cosine_hemisphere_pdf(found.wo)
            found.eta = mi.Float(1)
            found.sampled_type = mi.UInt32(+mi.BSDFFlags.GlossyReflection)
            good = active & (si.wi.z > 0) & (found.pdf > 0)
            return found, dr.select(good, self.eval(ctx, si, found.wo, active) / found.pdf, 0.0)

    return SampledByCosine
