main {
    let LobewiseGuide own = lobewise_read_guide(pixel);
    var float trusted = 0.0;
    var float told = 0.0;
    if (own.depth > 0.0) {
        for (var int v = -LOBEWISE_TRUST_RADIUS; v <= LOBEWISE_TRUST_RADIUS; v += 1) {
            for (var int u = -LOBEWISE_TRUST_RADIUS; u <= LOBEWISE_TRUST_RADIUS; u += 1) {
                let ivec2 other = pixel + ivec2(u, v);
                if (!lobewise_is_inside(other)) {
                    continue;
                }
                let LobewiseGuide there = lobewise_read_guide(other);
                if (there.depth <= 0.0) {
                    continue;
                }
                let vec2 offset = vec2(float(u), float(v));
                var float exponent = $screen;
                exponent += lobewise_compare_places(own.position, own.depth, there.position, there.depth);
                exponent += lobewise_compare_lobes(own, there);
                let float weight = exp2(exponent);
                trusted += weight * load(trust, other).x;
                told += weight;
            }
        }
    }
    var float share = 1.0;
    if (told > 0.0) {
        share = trusted / told;
    }
    // The kernel narrows as the history grows: weights are raised to the power unit.
    let float frames = load(history_more, pixel).z * share;
    store(narrowing, pixel, vec4(share, exp2(constants.growth * log2(frames + 1.0)), 0.0, 0.0));
}
