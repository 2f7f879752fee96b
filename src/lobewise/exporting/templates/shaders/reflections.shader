main {
    let vec4 given = load(surface, pixel);
    let vec4 spot = load(place, pixel);
    let float hit = load(hits, pixel).x;
    let vec3 view = spot.xyz - constants.eye;
    let float distance = length(view);
    var float inverse = 0.0;
    var vec2 before = vec2(-1.0e9, -1.0e9);
    if (hit > 0.0 && spot.w > 0.0) {
        var float way = LOBEWISE_MISS_DISTANCE * distance;
        if (lobewise_is_finite(hit)) {
            way = hit;
            inverse = 1.0 / hit;
        }
        // The mirror equation: the virtual image lies as far behind a flat mirror as the hit lies before it, and nearer
        // behind a convex one. The image of a concave mirror turns over at its focus, and is not followed from there on.
        let float opening = 1.0 + 2.0 * lobewise_find_curvature(pixel) * way;
        let vec3 behind = spot.xyz + view * (way / max(opening, 1.0e-6) / distance);
        let vec3 seen = lobewise_project(behind - constants.before);
        if (opening > 0.0 && seen.z > 0.0) {
            before = seen.xy;
        }
    }
    var float tolerance = LOBEWISE_HIT_TOLERANCE;
    if (lobewise_is_finite(given.w)) {
        tolerance += LOBEWISE_HIT_TOLERANCE_PER_LOBE * max(given.w, 0.0);
    }
    store(reflections, pixel, vec4(inverse, tolerance, before));
}
