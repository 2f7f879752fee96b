// A single spherical Gaussian exp((w.axis - 1) / variance).
struct LobewiseLobe {
    vec3 axis;
    float variance; // rad^2
};

// log2 of the overlap of two spherical Gaussians, to the power beta: as lobewise_sg_weight (Tokuyoshi 2015).
float lobewise_compare_reflections(LobewiseLobe i, LobewiseLobe j, float beta) {
    let vec3 d = j.axis - i.axis;
    let float total = i.variance + j.variance;
    let float sizes = 1.0 + 0.5 * (log2(i.variance) + log2(j.variance)) - log2(total);
    return beta * (sizes - 0.5 * LOBEWISE_LOG2_E * dot(d, d) / total);
}

// The lobe of a pixel of this frame. The square of a band-limit is added to its variance.
LobewiseLobe lobewise_read_lobe(ivec2 pixel, float tau) {
    let vec4 axis = load(axes, pixel);
    var LobewiseLobe lobe;
    lobe.axis = axis.xyz;
    lobe.variance = axis.w + tau * tau;
    return lobe;
}

// The lobe of a pixel of the frame before.
LobewiseLobe lobewise_read_lobe_before(ivec2 pixel, float tau) {
    let vec4 axis = load(axes_before, pixel);
    var LobewiseLobe lobe;
    lobe.axis = axis.xyz;
    lobe.variance = axis.w + tau * tau;
    return lobe;
}
