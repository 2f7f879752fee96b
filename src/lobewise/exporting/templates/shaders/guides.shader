main {
    let vec4 given = load(surface, pixel);
    let vec4 spot = load(place, pixel);
    let vec3 path = constants.eye - spot.xyz;
    let float square = dot(given.xyz, given.xyz);
    let bool is_near = spot.w > 0.0 && lobewise_is_finite(spot.w) && lobewise_is_finite(spot.x + spot.y + spot.z);
    if (!(is_near && square > LOBEWISE_MIN_SQUARED_NORMAL && lobewise_is_finite(square))) {
        store(points, pixel, vec4(0.0, 0.0, 0.0, 1.0));
        store(normals, pixel, vec4(0.0, 0.0, 0.0, 0.0));
        store(axes, pixel, vec4(0.0, 0.0, 0.0, -1.0));
$none        return;
    }
    let vec3 view = path / length(path);
    let vec3 normal = lobewise_face_viewer(given.xyz / sqrt(square), view);
    let float alpha = clamp(given.w, 0.0, 1.0);
    // The lobe has no band-limit yet: passes add their own, the square of an angle, to its variances.
$lobe    if (!lobewise_is_finite(given.w + axis.x + axis.y + axis.z + wide)) {
        wide = -1.0;
    }
    store(points, pixel, vec4(spot.xyz, $footprint));
    store(normals, pixel, vec4(given.xyz, spot.w));
    store(axes, pixel, vec4(axis, wide));
}
