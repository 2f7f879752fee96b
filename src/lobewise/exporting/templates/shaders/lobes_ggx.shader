// A GGX lobe, its covariance split: S = narrow (I - axis axis^T) + t t^T.
struct LobewiseLobe {
    vec3 axis;
    vec3 t;
    float wide; // the larger principal variance, rad^2
    float narrow; // the smaller one
};

// log2 of the overlap of two GGX lobes, to the power beta: as lobewise_ggx_weight, from split covariances.
float lobewise_compare_reflections(LobewiseLobe i, LobewiseLobe j, float beta) {
    let vec3 d = j.axis - i.axis;
    let float on_i = dot(d, i.t);
    let float on_j = dot(d, j.t);
    let float both = dot(i.t, j.t);
    let float quadratic = (i.wide + j.wide) * dot(d, d) - on_i * on_i - on_j * on_j;
    let float root_i = sqrt(i.wide * i.narrow);
    let float root_j = sqrt(j.wide * j.narrow);
    let float mean = root_i + root_j;
    // sqrt(P) is at least the mean of both s. Rounding may violate this.
    let float second = max((i.wide + j.narrow) * (j.wide + i.narrow) - both * both, mean * mean);
    let float q = min(quadratic / second, 4.0e4);
    let float tail = 8.0 * log2(1.0 + 0.25 * q);
    let float areas = log2(second * sqrt(second) / mean);
    return LOBEWISE_GGX_UNIT * beta * (log2(2.0 * root_i) + log2(2.0 * root_j) - tail - areas);
}

// The lobe of a pixel, from its axis and larger variance, and from t and its smaller variance. The square of a
// band-limit is added to both variances.
LobewiseLobe lobewise_join(vec4 axis, vec4 spread, float tau) {
    var LobewiseLobe lobe;
    lobe.axis = axis.xyz;
    lobe.t = spread.xyz;
    lobe.wide = axis.w + tau * tau;
    lobe.narrow = spread.w + tau * tau;
    return lobe;
}

// The lobe of a pixel of this frame.
LobewiseLobe lobewise_read_lobe(ivec2 pixel, float tau) {
    return lobewise_join(load(axes, pixel), load(spreads, pixel), tau);
}

// The lobe of a pixel of the frame before.
LobewiseLobe lobewise_read_lobe_before(ivec2 pixel, float tau) {
    return lobewise_join(load(axes_before, pixel), load(spreads_before, pixel), tau);
}
