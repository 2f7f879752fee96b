// What pixels are compared by: their places, and their specular lobes.
struct LobewiseGuide {
    vec3 position;
    float depth; // 0 where the pixel shows no surface, or has no lobe
    LobewiseLobe lobe;
};

// The guide of a pixel.
LobewiseGuide lobewise_read_guide(ivec2 pixel) {
    var LobewiseGuide guide;
    guide.position = load(points, pixel).xyz;
    guide.depth = load(normals, pixel).w;
    guide.lobe = lobewise_read_lobe(pixel, constants.tau);
    if (load(axes, pixel).w < 0.0) {
        guide.depth = 0.0;
    }
    return guide;
}

// log2 of the weight of the lobes of two pixels of this frame.
float lobewise_compare_lobes(LobewiseGuide i, LobewiseGuide j) {
    return lobewise_compare_reflections(i.lobe, j.lobe, constants.beta);
}

// Whether a pixel of this frame has light of this layer.
bool lobewise_is_usable(ivec2 pixel) {
    return load(normals, pixel).w > 0.0 && load(axes, pixel).w >= 0.0;
}

// Whether a pixel of the frame before had light of this layer.
bool lobewise_was_usable(ivec2 pixel) {
    return load(normals_before, pixel).w > 0.0 && load(axes_before, pixel).w >= 0.0;
}

// log2 of the Gaussian of the difference of two inverse hit distances, relative to the larger one.
float lobewise_compare_hits(vec2 hit_i, vec2 hit_j) {
    let float largest = max(max(hit_i.x, hit_j.x), 1.0e-12);
    let float way = (hit_i.x - hit_j.x) / largest;
    return -0.5 * LOBEWISE_LOG2_E * way * way / (hit_i.y * hit_j.y);
}

// log2 of the similarity of a pixel and a pixel of the frame before, by surface (if is_surface), lobe and what it hits.
float lobewise_compare_frames(ivec2 pixel, ivec2 before, bool is_surface) {
    let vec4 spot = load(points, pixel);
    let vec4 spot_before = load(points_before, before);
    let vec4 normal = load(normals, pixel);
    let vec4 normal_before = load(normals_before, before);
    let vec2 hit = load(reflections, pixel).xy;
    let vec2 hit_before = load(reflections_before, before).xy;
    let LobewiseLobe lobe = lobewise_read_lobe(pixel, constants.tau_between);
    let LobewiseLobe moved = lobewise_read_lobe_before(before, constants.tau_between);
    let float alike = lobewise_compare_reflections(lobe, moved, constants.beta_between);
    let float lobes = alike + lobewise_compare_hits(hit, hit_before);
    if (!is_surface) {
        return lobes;
    }
    return lobes + lobewise_compare_planes(spot, normal.xyz, spot_before, normal_before.xyz);
}
