// What pixels are compared by: their places, and the cosine lobes of their diffuse reflections.
struct LobewiseGuide {
    vec3 position;
    float depth; // 0 where the pixel shows no surface
    vec3 normal;
};

// The guide of a pixel.
LobewiseGuide lobewise_read_guide(ivec2 pixel) {
    let vec4 facing = load(normals, pixel);
    var LobewiseGuide guide;
    guide.position = load(points, pixel).xyz;
    guide.depth = facing.w;
    guide.normal = facing.xyz;
    return guide;
}

// log2 of the weight of the lobes of two pixels of this frame.
float lobewise_compare_lobes(LobewiseGuide i, LobewiseGuide j) {
    return lobewise_compare_cosines(i.normal, j.normal, constants.diffuse_beta);
}

// Whether a pixel of this frame has light of this layer.
bool lobewise_is_usable(ivec2 pixel) {
    return load(normals, pixel).w > 0.0;
}

// Whether a pixel of the frame before had light of this layer.
bool lobewise_was_usable(ivec2 pixel) {
    return load(normals_before, pixel).w > 0.0;
}

// log2 of the similarity of a pixel and a pixel of the frame before, by surface (if is_surface) and lobe.
float lobewise_compare_frames(ivec2 pixel, ivec2 before, bool is_surface) {
    let vec3 normal = load(normals, pixel).xyz;
    let vec3 normal_before = load(normals_before, before).xyz;
    let vec4 spot = load(points, pixel);
    let vec4 spot_before = load(points_before, before);
    let float lobes = lobewise_compare_cosines(normal, normal_before, constants.beta_between);
    if (!is_surface) {
        return lobes;
    }
    return lobes + lobewise_compare_planes(spot, normal, spot_before, normal_before);
}
