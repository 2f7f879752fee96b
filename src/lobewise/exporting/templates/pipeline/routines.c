/* routine: count_holes */
static void count_holes(${name}_pipeline *p, const halide_buffer_t *holes, int *count)
{
    const size_t pixels = (size_t)p->width * (size_t)p->height;
    size_t k;
    *count = 0;
    for (k = 0; k < pixels; k++) {
        *count += holes->host[k] != 0;
    }
}

/* routine: fill_bytes */
static void fill_bytes(${name}_pipeline *p, halide_buffer_t *image, int value)
{
    memset(image->host, value, (size_t)p->width * (size_t)p->height);
}

/* routine: find_mean_color */
static void find_mean_color(${name}_pipeline *p, const halide_buffer_t *color)
{
    const float *pixel = (const float *)color->host;
    const size_t pixels = (size_t)p->rows * (size_t)p->columns;
    double sums[3] = {0.0, 0.0, 0.0}, count = 0.0;
    size_t k;
    int channel;
    for (k = 0; k < pixels; k++, pixel += 3) {
        int good = 1;
        for (channel = 0; channel < 3; channel++) {
            good = good && pixel[channel] >= 0.0f && pixel[channel] <= 3.40282347e38f;
        }
        for (channel = 0; good && channel < 3; channel++) {
            sums[channel] += pixel[channel];
        }
        count += good;
    }
    for (channel = 0; channel < 3; channel++) {
        p->mean_color[channel] = (float)(sums[channel] / (count > 1.0 ? count : 1.0));
    }
}
