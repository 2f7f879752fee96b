// Shows a frame: noisy left of the line, denoised right of it.

struct Constants {
    line: f32, // place of the line, 0 (left) to 1 (right)
}
@group(0) @binding(0) var<uniform> constants: Constants;
@group(0) @binding(1) var diffuse: texture_2d<f32>;
@group(0) @binding(2) var specular: texture_2d<f32>;
@group(0) @binding(3) var emission: texture_2d<f32>;
@group(0) @binding(4) var image: texture_2d<f32>;

// One triangle that covers the canvas.
@vertex
fn cover(@builtin(vertex_index) number: u32) -> @builtin(position) vec4<f32> {
    let corner = vec2<f32>(f32(number & 1u), f32(number >> 1u));
    return vec4<f32>(4.0 * corner - 1.0, 0.0, 1.0);
}

// The transfer function of sRGB.
fn encode(light: vec3<f32>) -> vec3<f32> {
    let given = clamp(light, vec3<f32>(0.0), vec3<f32>(1.0));
    let curve = 1.055 * pow(given, vec3<f32>(1.0 / 2.4)) - 0.055;
    return select(curve, 12.92 * given, given <= vec3<f32>(0.0031308));
}

@fragment
fn show(@builtin(position) place: vec4<f32>) -> @location(0) vec4<f32> {
    let pixel = vec2<i32>(place.xy);
    let line = i32(round(constants.line * f32(textureDimensions(image).x)));
    if (pixel.x == line && line > 0) {
        return vec4<f32>(1.0);
    }
    var light = textureLoad(image, pixel, 0).xyz;
    if (pixel.x < line) {
        // Samples of blocks are shown as blocks.
        let block = textureDimensions(image).x / textureDimensions(diffuse).x;
        let sampled = pixel / i32(block);
        light = textureLoad(diffuse, sampled, 0).xyz + textureLoad(specular, sampled, 0).xyz;
        light += textureLoad(emission, pixel, 0).xyz;
    }
    return vec4<f32>(encode(light), 1.0);
}
