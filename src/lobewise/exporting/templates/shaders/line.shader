main {
    let LobewiseGuide own = lobewise_read_guide(pixel);
    var vec4 light = vec4(0.0, 0.0, 0.0, 0.0);
    var vec4 more = vec4(0.0, 0.0, 0.0, 0.0);
    if (own.depth > 0.0) {
        let float power = $power;
        for (var int k = -constants.radius; k <= constants.radius; k += 1) {
            let ivec2 other = pixel + ivec2($step);
            if (!lobewise_is_inside(other)) {
                continue;
            }
            let LobewiseGuide there = lobewise_read_guide(other);
            if (there.depth <= 0.0) {
                continue;
            }
            var float exponent = lobewise_compare_screen(vec2(float(k), 0.0), constants.screen_sigma);
            exponent += lobewise_compare_places(own.position, own.depth, there.position, there.depth);
            exponent += lobewise_compare_lobes(own, there);
            let float weight = exp2(power * exponent);
            let LobewiseTap tap = $read(other);
            light += weight * tap.light;
            more += weight * vec4(weight * tap.more.x, tap.more.y, 0.0, 0.0);
        }
    }
    // Undivided sums: a pixel with few similar pixels in its row then counts little in the column.
    store(added_light, pixel, light);
    store(added_more, pixel, more);
}
