layout(local_size_x = $across, local_size_y = $down) in;
void main() {
    ivec2 pixel = ivec2(gl_GlobalInvocationID.xy);
    if (pixel.x >= constants.$columns || pixel.y >= constants.$rows) {
        return;
    }
