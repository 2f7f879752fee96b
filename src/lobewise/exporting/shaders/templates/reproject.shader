main {
    var vec4 light = vec4(0.0, 0.0, 0.0, 0.0);
    var vec4 more = vec4(0.0, 0.0, 0.0, 0.0);
    let vec2 moved = load(motion, pixel).xy;
    let float column = float(pixel.x) + moved.x;
    let float row = float(pixel.y) + moved.y;
    let bool is_near = column > -1.0 && row > -1.0 && column < float(constants.width) && row < float(constants.height);
    if (lobewise_is_usable(pixel) && lobewise_is_finite(column + row) && is_near) {
        let vec2 spot = vec2(lobewise_snap(column), lobewise_snap(row));
        let vec2 corner = floor(spot);
        // The four pixels around the place, by bilinear weights times the similarity of surface and lobe.
        for (var int k = 0; k < 4; k += 1) {
            let int u = k % 2;
            let int v = k / 2;
            let ivec2 before = ivec2(int(corner.x) + u, int(corner.y) + v);
            if (!lobewise_is_inside(before)) {
                continue;
            }
            let vec4 old_light = load(past_light, before);
            let vec4 old_more = load(past_more, before);
            let float total = old_light.x + old_light.y + old_light.z + old_light.w + old_more.x + old_more.y + old_more.z;
            if (!lobewise_was_usable(before) || lobewise_is_bad(total)) {
                continue;
            }
            let float agreement = exp2(lobewise_compare_frames(pixel, before));
            let vec2 share = vec2(float(1 - u), float(1 - v)) - (spot - corner);
            let float weight = abs(share.x * share.y) * agreement;
            light += weight * old_light;
            more += weight * vec4(agreement * old_more.x, old_more.y, old_more.z, 1.0);
        }
    }
    let float memory = constants.memory;
    store(history_light, pixel, memory * light);
    store(history_more, pixel, vec4(memory * memory * more.x, memory * more.y, memory * more.z, more.w));
}
