main {
    let vec4 given = load(narrowing, pixel);
    let float share = given.x;
    let float unit = given.y;
    let vec4 past_light = load(history_light, pixel);
    let vec4 past_more = load(history_more, pixel);
    // The history, faded by its trust.
    var vec4 light = share * past_light;
    var vec3 more = vec3(share * share * past_more.x, share * past_more.y, share * past_more.z);
    if (lobewise_is_usable(pixel)) {
        let vec4 added = load(sums_light, pixel);
        let vec4 beside = load(sums_more, pixel);
        let LobewiseSums found = lobewise_weigh(added, beside.x, beside.y, unit);
        let vec3 tint = load(albedo, pixel).xyz;
        let vec4 mine = lobewise_divide(load(radiance, pixel).xyz, tint, LOBEWISE_ALBEDO_FLOOR / constants.own);
        let LobewiseSums bonus = lobewise_weigh_own(mine, unit);
        light += found.light + bonus.light;
        more += found.more + bonus.more;
    }
    store(kept_light, pixel, light);
    store(kept_more, pixel, vec4(more, 0.0));
}
