main {
    let vec3 diffuse_tint = load(diffuse_albedo, pixel).xyz;
    let vec3 specular_tint = load(specular_albedo, pixel).xyz;
    let vec3 diffuse = lobewise_finish(load(diffuse_sums, pixel), diffuse_tint, $diffuse_noisy);
    let vec3 specular = lobewise_finish(load(specular_sums, pixel), specular_tint, $specular_noisy);
    var vec3 rest = load(emission, pixel).xyz;
    if (!lobewise_is_good(rest)) {
        rest = vec3(0.0, 0.0, 0.0);
    }
    store(image, pixel, vec4(diffuse + specular + rest, 1.0));
}
