/* part: is_good_pixel */
static int is_good_pixel(const float *pixel)
{
    int channel, good = 1;
    for (channel = 0; channel < 3; channel++) {
        good = good && pixel[channel] >= 0.0f && pixel[channel] <= 3.40282347e38f;
    }
    return good;
}

/* part: count_holes */
static void count_holes(${name}_pipeline *p, const halide_buffer_t *holes, double *count)
{
    int x, y;
    (void)p;
    *count = 0.0;
    for (y = 0; y < holes->dim[1].extent; y++) {
        const uint8_t *row = holes->host + (ptrdiff_t)y * holes->dim[1].stride;
        for (x = 0; x < holes->dim[0].extent; x++) {
            *count += row[x] != 0;
        }
    }
}

/* part: find_box */
static void find_box(${name}_pipeline *p, const halide_buffer_t *mask, int reach)
{
    /* The box holds all pixels of the mask and what is so near; it is at least as wide as a vector. */
    int left = p->width, right = -1, top = p->height, bottom = -1, x, y;
    for (y = 0; y < p->height; y++) {
        const uint8_t *row = mask->host + (size_t)y * (size_t)p->width;
        for (x = 0; x < p->width; x++) {
            if (row[x]) {
                left = x < left ? x : left;
                right = x > right ? x : right;
                top = y < top ? y : top;
                bottom = y;
            }
        }
    }
    left = left > reach ? left - reach : 0;
    top = top > reach ? top - reach : 0;
    right = right + reach + 1 < p->width ? right + reach + 1 : p->width;
    bottom = bottom + reach + 1 < p->height ? bottom + reach + 1 : p->height;
    if (right - left < LEAST_WIDTH) {
        left = right > LEAST_WIDTH ? right - LEAST_WIDTH : 0;
        right = left + LEAST_WIDTH;
    }
    p->box.left = left;
    p->box.top = top;
    p->box.width = right - left;
    p->box.height = bottom - top;
}

/* part: measure_mean_color */
static void measure_mean_color(${name}_pipeline *p, const halide_buffer_t *color, double *mean)
{
    const float *pixel = (const float *)color->host;
    const size_t pixels = (size_t)p->rows * (size_t)p->columns;
    double sums[3] = {0.0, 0.0, 0.0}, count = 0.0;
    size_t k;
    int channel;
    for (k = 0; k < pixels; k++, pixel += 3) {
        const int good = is_good_pixel(pixel);
        for (channel = 0; good && channel < 3; channel++) {
            sums[channel] += pixel[channel];
        }
        count += good;
    }
    for (channel = 0; channel < 3; channel++) {
        mean[channel] = (float)(sums[channel] / (count > 1.0 ? count : 1.0));
    }
}

/* part: copy_image */
static void copy_image(${name}_pipeline *p, const halide_buffer_t *from, halide_buffer_t *to)
{
    size_t bytes = from->type.bits / 8;
    int axis;
    (void)p;
    for (axis = 0; axis < from->dimensions; axis++) {
        bytes *= (size_t)from->dim[axis].extent;
    }
    memcpy(to->host, from->host, bytes);
}

/* part: clear_image */
static void clear_image(${name}_pipeline *p, halide_buffer_t *image)
{
    size_t bytes = image->type.bits / 8;
    int axis;
    (void)p;
    for (axis = 0; axis < image->dimensions; axis++) {
        bytes *= (size_t)image->dim[axis].extent;
    }
    memset(image->host, 0, bytes);
}

/* part: measure_cover */
static void measure_cover(${name}_pipeline *p, const halide_buffer_t *mask, double *share)
{
    /* The share of the pixels that have the light of a mask. */
    const size_t pixels = (size_t)p->width * (size_t)p->height;
    size_t count = 0, k;
    for (k = 0; k < pixels; k++) {
        count += mask->host[k] != 0;
    }
    *share = (double)count / (double)pixels;
}

/* part: measure_share */
static void measure_share(
    ${name}_pipeline *p, const halide_buffer_t *agreement, const halide_buffer_t *places, const halide_buffer_t *mask,
    double least_agreement, double longest_step, double most_samples, double *share)
{
    /* The share of surfaces that are found in the frame before, not too far away. */
    const float *agrees = (const float *)agreement->host, *place = (const float *)places->host;
    const int shorter = p->width < p->height ? p->width : p->height;
    const int longer = p->width < p->height ? p->height : p->width;
    const int step = shorter / (int)most_samples > 1 ? shorter / (int)most_samples : 1;
    const float reach = (float)(longest_step * longer);
    size_t found = 0, count = 0;
    int x, y;
    for (y = 0; y < p->height; y += step) {
        for (x = 0; x < p->width; x += step) {
            const size_t k = (size_t)y * (size_t)p->width + (size_t)x;
            const int near = fabsf(place[2 * k] - (float)x) < reach && fabsf(place[2 * k + 1] - (float)y) < reach;
            const int is_surface = mask->host[k] != 0;
            count += is_surface;
            found += is_surface && near && (double)agrees[k] > least_agreement;
        }
    }
    *share = count == 0 ? 1.0 : (double)found / (double)count;
}

/* part: pick_samples */
static void pick_samples(
    ${name}_pipeline *p, const halide_buffer_t *from, halide_buffer_t *to, int row, int column, int is_stack)
{
    /* Entries of a pixel lie together; a stack has one image after the other. */
    const size_t layers = is_stack ? (size_t)from->dim[2].extent : 1;
    const size_t bytes = from->type.bits / 8 * (from->dimensions > 2 && !is_stack ? (size_t)from->dim[0].extent : 1);
    const uint8_t *source = from->host;
    uint8_t *target = to->host;
    size_t layer;
    int y, x;
    for (layer = 0; layer < layers; layer++, source += bytes * (size_t)p->width * (size_t)p->height) {
        for (y = row; y < p->height; y += SCALE) {
            for (x = column; x < p->width; x += SCALE, target += bytes) {
                memcpy(target, source + bytes * ((size_t)y * (size_t)p->width + (size_t)x), bytes);
            }
        }
    }
}

/* part: measure_level */
static void measure_level(
    ${name}_pipeline *p, const halide_buffer_t *sums, const halide_buffer_t *mask, double *level)
{
    /* The light of rows in parts, over the number of pixels of the layer. */
    const size_t parts = (size_t)sums->dim[0].extent * (size_t)p->height;
    const size_t pixels = (size_t)p->width * (size_t)p->height;
    const float *part = (const float *)sums->host;
    double light = 0.0, count = 0.0;
    size_t k;
    for (k = 0; k < parts; k++) {
        light += part[k];
    }
    for (k = 0; k < pixels; k++) {
        count += mask->host[k] != 0;
    }
    *level = light / (count > 1.0 ? count : 1.0);
}

/* part: measure_brightness */
static void measure_brightness(${name}_pipeline *p, const halide_buffer_t *color, double *brightness)
{
    /* The squared mean of the root of the light. One firefly of a row must not decide how bright the image is. */
    const float *pixel = (const float *)color->host;
    double sum = 0.0, mean;
    int x, y;
    for (y = 0; y < p->height; y++) {
        double row = 0.0, first = 0.0, second = 0.0;
        for (x = 0; x < p->width; x++, pixel += 3) {
            const double root = is_good_pixel(pixel) ? sqrt(((double)pixel[0] + pixel[1] + pixel[2]) / 3.0) : 0.0;
            second = root > first ? first : root > second ? root : second;
            first = root > first ? root : first;
            row += root;
        }
        sum += row - first + fmin(first, ${MAX_RATIO_TO_NEXT} * second);
    }
    mean = sum / ((double)p->width * (double)p->height);
    *brightness = mean * mean + ${MIN_BRIGHTNESS};
}

/* part: measure_log_depth */
static void measure_log_depth(${name}_pipeline *p, const halide_buffer_t *depth, double *mean)
{
    const float *values = (const float *)depth->host;
    const size_t pixels = (size_t)p->width * (size_t)p->height;
    double sum = 0.0, count = 0.0;
    size_t k;
    for (k = 0; k < pixels; k++) {
        if (values[k] > 0.0f && values[k] <= FLT_MAX) {
            sum += logf(values[k]);
            count += 1.0;
        }
    }
    *mean = count > 0.0 ? sum / count : 0.0;
}

/* part: share_missing */
static void share_missing(
    ${name}_pipeline *p, const halide_buffer_t *noisy, const halide_buffer_t *filtered, const halide_buffer_t *mask,
    const halide_buffer_t *uncounted, double *gain)
{
    /* How much of a layer's light is shared out, over its light. The light that is missing is as sure as the equal
       fireflies are many that would explain it. */
    const size_t pixels = (size_t)p->width * (size_t)p->height;
    const float *before = (const float *)noisy->host, *after = (const float *)filtered->host;
    double light = 0.0, missing = 0.0, squared = 0.0, whole = 0.0, largest = 0.0;
    size_t k;
    gain[0] = 0.0;
    for (k = 0; k < pixels; k++, before += 3, after += 3) {
        if (is_good_pixel(before) && is_good_pixel(after) && !(uncounted && uncounted->host[k])) {
            const double sum = (double)before[0] + before[1] + before[2], left = (double)after[0] + after[1] + after[2];
            const double lost = sum - left;
            light += sum;
            missing += lost;
            squared += lost * lost;
            largest = fmax(largest, lost);
            whole += mask->host[k] ? left : 0.0;
        }
    }
    if (whole > 0.0 && squared > 0.0 && squared <= DBL_MAX && missing != 0.0) {
        const double fireflies = fmax(missing * missing / squared, 1.0);
        const double known = (1.0 - 1.0 / (fireflies * fireflies)) * fabs(missing);
        /* One firefly, which the next frame has not, must not change the light of the image. */
        const double sure = missing < 0.0 ? -missing : fmax(missing - largest, 0.0);
        const double share = fmax(known, fmin(sure, ${MAX_SHARED_AS_NOISE} * whole)) / whole;
        const double most = fmin(share, ${MAX_GAIN_PER_FIREFLY} * fireflies);
        gain[0] = missing < 0.0 ? -fmin(most, ${MAX_FALL}) : fmin(most, ${MAX_GAIN});
    }
    /* The light of the samples, and what is missing of it after sharing. */
    gain[1] = light;
    gain[2] = missing - gain[0] * whole;
}

/* part: measure_gain */
static void measure_gain(
    ${name}_pipeline *p, const halide_buffer_t *noisy, const halide_buffer_t *filtered, const halide_buffer_t *mask,
    double *gain)
{
    share_missing(p, noisy, filtered, mask, NULL, gain);
}

/* part: measure_gain_outside */
static void measure_gain_outside(
    ${name}_pipeline *p, const halide_buffer_t *noisy, const halide_buffer_t *filtered, const halide_buffer_t *mask,
    const halide_buffer_t *uncounted, double *gain)
{
    share_missing(p, noisy, filtered, mask, uncounted, gain);
}
