[numthreads($across, $down, 1)]
void main(uint3 thread : SV_DispatchThreadID) {
    int2 pixel = int2(thread.xy);
    if (pixel.x >= constants.$columns || pixel.y >= constants.$rows) {
        return;
    }
