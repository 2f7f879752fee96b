// The shaded pixel of a block.
ivec2 lobewise_find_pixel(ivec2 block) {
    return ivec2(block.x * constants.scale + constants.column, block.y * constants.scale + constants.row);
}

// Whether the lobe of a pixel reflects so much that an own sample would show its light.
bool lobewise_reflects(ivec2 pixel) {
    let vec3 tint = load(albedo, pixel).xyz;
    return max(max(tint.x, tint.y), tint.z) > LOBEWISE_ALBEDO_FLOOR / constants.own;
}

// A sample's radiance over the albedo of its pixel (xyz), and 1 (w); all 0 if it is bad.
vec4 lobewise_read_shaded(ivec2 block, float least) {
    let ivec2 shaded = lobewise_find_pixel(block);
    let vec3 given = load(radiance, block).xyz;
    return lobewise_divide(given, load(albedo, shaded).xyz, least);
}

// log2 of the weight of a sample for a pixel, less narrowing times the squared distance in pixels. Where there is no sample
// it is so low that the weight is 0.
float lobewise_compare_tap(LobewiseGuide own, ivec2 pixel, ivec2 block, float narrowing) {
    let ivec2 shaded = lobewise_find_pixel(block);
    if (block.x < 0 || block.y < 0 || block.x >= constants.columns || block.y >= constants.rows) {
        return -1.0e4;
    }
    let LobewiseGuide there = lobewise_read_guide(shaded);
    if (there.depth <= 0.0 || !lobewise_reflects(shaded)) {
        return -1.0e4;
    }
    let vec2 offset = vec2(float(shaded.x - pixel.x), float(shaded.y - pixel.y));
    var float exponent = lobewise_compare_screen(offset, constants.screen_sigma) - narrowing * dot(offset, offset);
    exponent += lobewise_compare_places(own.position, own.depth, there.position, there.depth);
    return exponent + lobewise_compare_lobes(own, there);
}
