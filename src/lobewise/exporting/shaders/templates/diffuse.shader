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
