main {
    let ivec2 here = $here;
    let LobewiseGuide own = lobewise_read_guide(here);
    let LobewiseDifference mine = lobewise_compare_sample(pixel, here);
    var float excess = 0.0;
    if (own.depth > 0.0 && mine.known > 0.0) {
        var vec3 above = vec3(0.0, 0.0, 0.0);
        var vec3 below = vec3(0.0, 0.0, 0.0);
        var vec3 squares = vec3(0.0, 0.0, 0.0);
        var float total = 0.0;
        var float weights = 0.0;
        for (var int v = -LOBEWISE_TRUST_RADIUS; v <= LOBEWISE_TRUST_RADIUS; v += 1) {
            for (var int u = -LOBEWISE_TRUST_RADIUS; u <= LOBEWISE_TRUST_RADIUS; u += 1) {
                let ivec2 tap = pixel + ivec2(u, v);
                if (tap.x < 0 || tap.y < 0 || tap.x >= constants.$columns || tap.y >= constants.$rows) {
                    continue;
                }
                let ivec2 other = $other;
                let LobewiseGuide there = lobewise_read_guide(other);
                let LobewiseDifference found = lobewise_compare_sample(tap, other);
                if (there.depth <= 0.0 || found.known <= 0.0) {
                    continue;
                }
                let vec2 offset = vec2(float(other.x - here.x), float(other.y - here.y));
                var float exponent = $screen;
                exponent += lobewise_compare_places(own.position, own.depth, there.position, there.depth);
                exponent += lobewise_compare_lobes(own, there);
                let float weight = exp2(exponent);
                above += weight * max(found.step, vec3(0.0, 0.0, 0.0));
                below += weight * max(-found.step, vec3(0.0, 0.0, 0.0));
                squares += weight * found.step * found.step;
                total += weight;
                weights += weight * weight;
            }
        }
        var float count = 1.0;
        if (weights > 0.0) {
            count = total * total / weights;
        }
        // A single sample does not show its deviation.
        if (total > 0.0 && count > 1.5) {
            above = above / total;
            below = below / total;
            squares = squares / total;
            let float red = lobewise_find_errors(above.x, below.x, squares.x, mine.before.x, count);
            let float green = lobewise_find_errors(above.y, below.y, squares.y, mine.before.y, count);
            let float blue = lobewise_find_errors(above.z, below.z, squares.z, mine.before.z, count);
            excess = max(max(red, green), blue);
        }
    }
    let float range = LOBEWISE_NO_TRUST_ERRORS - LOBEWISE_FULL_TRUST_ERRORS;
    store(trust, pixel, vec4(clamp((LOBEWISE_NO_TRUST_ERRORS - excess) / range, 0.0, 1.0), 0.0, 0.0, 0.0));
}
