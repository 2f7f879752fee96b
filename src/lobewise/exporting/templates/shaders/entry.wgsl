@compute @workgroup_size($across, $down)
fn main(@builtin(global_invocation_id) thread: vec3<u32>) {
    let pixel = vec2<i32>(thread.xy);
    if (pixel.x >= constants.$columns || pixel.y >= constants.$rows) {
        return;
    }
