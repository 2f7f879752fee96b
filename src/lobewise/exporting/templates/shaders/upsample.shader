main {
    let LobewiseGuide own = lobewise_read_guide(pixel);
    if (own.depth <= 0.0 || !lobewise_reflects(pixel)) {
        store(kept_light, pixel, vec4(0.0, 0.0, 0.0, 0.0));
        store(kept_more, pixel, vec4(0.0, 0.0, 0.0, 0.0));
        return;
    }
    let ivec2 block = ivec2(pixel.x / constants.scale, pixel.y / constants.scale);
    let vec4 past_light = load(history_light, pixel);
    let vec4 past_more = load(history_more, pixel);
    // Average the trust of the samples around.
    var float trusted = 0.0;
    var float told = 0.0;
    for (var int down = -1; down <= 1; down += 1) {
        for (var int right = -1; right <= 1; right += 1) {
            let ivec2 tap = block + ivec2(right, down);
            let float weight = exp2(lobewise_compare_tap(own, pixel, tap, 0.0));
            if (weight > 0.0) {
                trusted += weight * load(trust, tap).x;
                told += weight;
            }
        }
    }
    var float share = 1.0;
    if (told > 0.0) {
        share = trusted / told;
    }
    // The kernel narrows as the history grows: weights are raised to the power unit. It also has fewer taps where there
    // is a history.
    let float unit = exp2(constants.growth * log2(past_more.z * share + 1.0));
    let ivec2 nearest = ivec2(min(block.x, constants.columns - 1), min(block.y, constants.rows - 1));
    var int reach = constants.radius;
    var float narrowing = 0.0;
    if (past_more.z * load(trust, nearest).x >= LOBEWISE_MIN_KNOWN_FRAMES) {
        let float known = 1.0 / (constants.known_sigma * constants.known_sigma);
        reach = constants.known_radius;
        narrowing = 0.5 * LOBEWISE_LOG2_E * (known - 1.0 / (constants.screen_sigma * constants.screen_sigma));
    }
    // Gather the samples.
    var vec4 light = vec4(0.0, 0.0, 0.0, 0.0);
    var float squares = 0.0;
    var float moment = 0.0;
    for (var int v = -reach; v <= reach; v += 1) {
        for (var int u = -reach; u <= reach; u += 1) {
            let ivec2 tap = block + ivec2(u, v);
            let float weight = exp2(unit * lobewise_compare_tap(own, pixel, tap, narrowing));
            if (weight > 0.0) {
                let vec4 found = lobewise_read_shaded(tap, LOBEWISE_ALBEDO_FLOOR);
                let float luminance = dot(LOBEWISE_LUMINANCE, found.xyz);
                light += weight * found;
                squares += weight * weight * found.w;
                moment += weight * luminance * luminance;
            }
        }
    }
    let LobewiseSums added = lobewise_weigh(light, squares, moment, unit);
    light = share * past_light + added.light;
    var vec3 more = vec3(share * share * past_more.x, share * past_more.y, share * past_more.z) + added.more;
    let ivec2 shaded = lobewise_find_pixel(block);
    if (shaded.x == pixel.x && shaded.y == pixel.y && block.x < constants.columns && block.y < constants.rows) {
        let vec4 mine = lobewise_read_shaded(block, LOBEWISE_ALBEDO_FLOOR / constants.own);
        let LobewiseSums bonus = lobewise_weigh_own(mine, unit);
        light += bonus.light;
        more += bonus.more;
    }
    store(kept_light, pixel, light);
    store(kept_more, pixel, vec4(more, 0.0));
}
