main {
    var LobewiseHistory found;
    found.light = vec4(0.0, 0.0, 0.0, 0.0);
    found.more = vec4(0.0, 0.0, 0.0, 0.0);
    if (lobewise_is_usable(pixel)) {
        found = lobewise_gather(pixel, vec2(float(pixel.x), float(pixel.y)) + load(motion, pixel).xy, true);
$reflection    }
    let float memory = constants.memory;
    let vec4 more = found.more;
    store(history_light, pixel, memory * found.light);
    store(history_more, pixel, vec4(memory * memory * more.x, memory * more.y, memory * more.z, more.w));
}
