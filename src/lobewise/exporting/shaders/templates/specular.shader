// The lobe of a pixel, from its axis and larger variance, and from t and its smaller variance. The square of a
// band-limit is added to both variances.
LobewiseSplit lobewise_join(vec4 axis, vec4 spread, float tau) {
    var LobewiseSplit lobe;
    lobe.axis = axis.xyz;
    lobe.t = spread.xyz;
    lobe.wide = axis.w + tau * tau;
    lobe.narrow = spread.w + tau * tau;
    return lobe;
}

// What pixels are compared by: their places, and their specular lobes.
struct LobewiseGuide {
    vec3 position;
    float depth; // 0 where the pixel shows no surface, or has no lobe
    LobewiseSplit lobe;
};

// The guide of a pixel.
LobewiseGuide lobewise_read_guide(ivec2 pixel) {
    let vec4 axis = load(axes, pixel);
    var LobewiseGuide guide;
    guide.position = load(points, pixel).xyz;
    guide.depth = load(normals, pixel).w;
    guide.lobe = lobewise_join(axis, load(spreads, pixel), constants.tau);
    if (axis.w < 0.0) {
        guide.depth = 0.0;
    }
    return guide;
}

// log2 of the weight of the lobes of two pixels of this frame.
float lobewise_compare_lobes(LobewiseGuide i, LobewiseGuide j) {
    return lobewise_compare_ggx(i.lobe, j.lobe, constants.beta);
}

// Whether a pixel of this frame has light of this layer.
bool lobewise_is_usable(ivec2 pixel) {
    return load(normals, pixel).w > 0.0 && load(axes, pixel).w >= 0.0;
}

// Whether a pixel of the frame before had light of this layer.
bool lobewise_was_usable(ivec2 pixel) {
    return load(normals_before, pixel).w > 0.0 && load(axes_before, pixel).w >= 0.0;
}

// log2 of the similarity of a pixel and a pixel of the frame before, by surface and lobe.
float lobewise_compare_frames(ivec2 pixel, ivec2 before) {
    let vec4 spot = load(points, pixel);
    let vec4 spot_before = load(points_before, before);
    let vec3 normal = load(normals, pixel).xyz;
    let vec3 normal_before = load(normals_before, before).xyz;
    let LobewiseSplit lobe = lobewise_join(load(axes, pixel), load(spreads, pixel), constants.tau_between);
    let vec4 axis_before = load(axes_before, before);
    let vec4 spread_before = load(spreads_before, before);
    let LobewiseSplit lobe_before = lobewise_join(axis_before, spread_before, constants.tau_between);
    let float surface = lobewise_compare_planes(spot, normal, spot_before, normal_before);
    return surface + lobewise_compare_ggx(lobe, lobe_before, constants.beta_between);
}
