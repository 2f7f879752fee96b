// What pixels are compared by: their places, and their specular lobes.
struct LobewiseGuide {
    vec3 position;
    float depth; // 0 where the pixel shows no surface, or has no lobe
    LobewiseSplit lobe;
};

// The guide of a pixel. The square of a band-limit is added to the variances of its lobe.
LobewiseGuide lobewise_read_guide(ivec2 pixel) {
    let vec4 axis = load(axes, pixel);
    let vec4 spread = load(spreads, pixel);
    let float noise = constants.tau * constants.tau;
    var LobewiseGuide guide;
    guide.position = load(points, pixel).xyz;
    guide.depth = load(normals, pixel).w;
    guide.lobe.axis = axis.xyz;
    guide.lobe.t = spread.xyz;
    guide.lobe.wide = axis.w + noise;
    guide.lobe.narrow = spread.w + noise;
    if (axis.w < 0.0) {
        guide.depth = 0.0;
    }
    return guide;
}

// log2 of the weight of the lobes of two pixels of this frame.
float lobewise_compare_lobes(LobewiseGuide i, LobewiseGuide j) {
    return lobewise_compare_ggx(i.lobe, j.lobe, constants.beta);
}
