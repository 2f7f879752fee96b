/* ${title}: the steps of the plan, in order. Made by lobewise ${version} from the plan; do not edit. C99. */
#include "${name}.h"

#include <float.h>
#include <math.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>

#include "HalideRuntime.h"

enum { MAX_SIZE = 32768, LEAST_WIDTH = ${least}, SCALE = ${scale}, BAND_ROWS = ${band_rows}, ALIGNMENT = 128, MARGIN = 256 };

/* The axes of images: a length, or one of these. */
enum { HEIGHT = -1, WIDTH = -2, ROWS = -3, COLUMNS = -4, BAND = -5${lengths} };

/* Places in memory: shared by images that are not needed at once, the state, and memory of the caller. */
enum {
${places}
    PLACES
};

enum {
${images}
    IMAGES
};

${declare}
struct image_info {
    int place;
    int is_bytes;
    int axes;
    int shape[4];
    int plane; /* number of the plane, for images that are a plane of a larger one */
    int still; /* axis whose entries lie in one place, or -1 */
};

static const struct image_info INFO[IMAGES] = {
${infos}
};

${held}

/* What a camera gives. Directions are of unit length; rays have length 1 along the camera's axis. */
struct view {
    double eye[3], forward[3], right[3], up[3];
    double pixel_angle;
    double first_ray[3], ray_right[3], ray_down[3]; /* the first pixel's ray, and its steps right and down */
    double before_right[3], before_up[3];           /* axes in units of the half image */
};

struct ${name}_pipeline {
    int width, height, rows, columns;
    int has_past; /* whether there was a frame before */
    size_t bytes;
    ${name}_settings settings;
    const ${name}_frame *frame;
    struct view view, view_before;
    struct {
${numbers}
        int unused;
    } numbers;
${reals}
    struct {
        int left, top, width, height;
    } box; /* part of the image that some steps compute */
    void *allocated[PLACES];
    void *memory[PLACES];
    halide_dimension_t dims[IMAGES][4];
    halide_buffer_t images[IMAGES];
${blocks}
    double seconds[${name}_stages];
    ${name}_progress progress;
    void *user;
    char message[256];
};

/* The compiled kernels. Each returns 0, or an error code of Halide's. */
${prototypes}

static char halide_message[160];

/* Halide's own handler would abort the program. */
static void keep_message(void *context, const char *message)
{
    (void)context;
    snprintf(halide_message, sizeof halide_message, "%s", message);
}

static ${name}_status refuse(${name}_pipeline *p, ${name}_status status, const char *message)
{
    snprintf(p->message, sizeof p->message, "%s", message);
    return status;
}

const char *${name}_explain(${name}_status status)
{
    switch (status) {
    case ${name}_ok: return "nothing went wrong";
    case ${name}_no_memory: return "there is not enough memory for a pipeline of this size";
    case ${name}_bad_size: return "width must be ${least} to 32768 and height 1 to 32768";
    case ${name}_no_image: return "an image that the pipeline reads or writes is NULL";
    case ${name}_bad_camera: return "the camera needs finite numbers, angles above 0 and below pi, and an up vector that is not parallel to forward";
    case ${name}_bad_setting: return "a setting is out of range";
    case ${name}_bad_place: return "row and column of the shaded pixel must lie inside its block";
    case ${name}_failed: return "a kernel failed";
    case ${name}_cancelled: return "the frame was cancelled";
    case ${name}_no_device: return "the device of the target cannot be used, or has not enough memory";
    }
    return "unknown status";
}

/* Cameras. */

static double dot(const double a[3], const double b[3])
{
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
}

static void cross(const double a[3], const double b[3], double out[3])
{
    out[0] = a[1] * b[2] - a[2] * b[1];
    out[1] = a[2] * b[0] - a[0] * b[2];
    out[2] = a[0] * b[1] - a[1] * b[0];
}

static int make_view(const ${name}_camera *camera, int width, int height, struct view *view)
{
    const double half_height = tan(0.5 * camera->fov_y);
    const double half_width = camera->fov_x > 0.0 ? tan(0.5 * camera->fov_x) : half_height * width / height;
    double right[3], ahead, side, total = camera->fov_y + camera->fov_x + camera->shift[0] + camera->shift[1];
    int k;
    for (k = 0; k < 3; k++) {
        total += camera->position[k] + camera->forward[k] + camera->up[k];
    }
    cross(camera->forward, camera->up, right);
    ahead = sqrt(dot(camera->forward, camera->forward));
    side = sqrt(dot(right, right));
    if (!(fabs(total) <= 1e38 && camera->fov_y > 0.0 && camera->fov_y < 3.14159265 && camera->fov_x < 3.14159265 &&
          camera->fov_x >= 0.0 && side > 1e-9 * ahead * sqrt(dot(camera->up, camera->up)))) {
        return 0;
    }
    for (k = 0; k < 3; k++) {
        view->eye[k] = camera->position[k];
        view->forward[k] = camera->forward[k] / ahead;
        right[k] /= side;
    }
    cross(right, view->forward, view->up);
    cross(view->forward, view->up, view->right);
    view->pixel_angle = 2.0 * tan(0.5 * camera->fov_y) / height;
    for (k = 0; k < 3; k++) {
        const double middle =
            view->forward[k] + camera->shift[0] * view->right[k] + camera->shift[1] * view->up[k];
        view->ray_right[k] = 2.0 * half_width / width * view->right[k];
        view->ray_down[k] = -2.0 * half_height / height * view->up[k];
        view->first_ray[k] = middle - half_width * view->right[k] + half_height * view->up[k] +
                             0.5 * (view->ray_right[k] + view->ray_down[k]);
        view->before_right[k] = (view->right[k] - camera->shift[0] * view->forward[k]) / half_width;
        view->before_up[k] = (view->up[k] - camera->shift[1] * view->forward[k]) / half_height;
    }
    return 1;
}

/* Small steps between kernels. */
${routines}

/* Memory. */

static int find_length(const ${name}_pipeline *p, int axis)
{
    switch (axis) {
    case HEIGHT: return p->height;
    case WIDTH: return p->width;
    case ROWS: return p->rows;
    case COLUMNS: return p->columns;
    case BAND: return BAND_ROWS;
${cases}
    default: return axis;
    }
}

/* Bytes of an image, and its axes in Halide's order: the axis with the smallest stride comes first. */
static size_t describe_image(${name}_pipeline *p, int image)
{
    const struct image_info *info = &INFO[image];
    halide_buffer_t *buffer = &p->images[image];
    size_t bytes = info->is_bytes ? 1 : 4;
    int axis, stride = 1;
    memset(buffer, 0, sizeof *buffer);
    for (axis = 0; axis < info->axes; axis++) {
        halide_dimension_t *d = &p->dims[image][axis];
        const int number = info->axes - 1 - axis;
        d->min = 0;
        d->extent = find_length(p, info->shape[number]);
        d->stride = number == info->still ? 0 : stride;
        d->flags = 0;
        stride *= number == info->still ? 1 : d->extent;
        bytes *= number == info->still ? 1 : (size_t)d->extent;
    }
    buffer->dim = p->dims[image];
    buffer->dimensions = info->axes;
    buffer->type.code = info->is_bytes ? halide_type_uint : halide_type_float;
    buffer->type.bits = info->is_bytes ? 8 : 32;
    buffer->type.lanes = 1;
    return bytes;
}

${crop}
${device}
${swap_places}static void place_images(${name}_pipeline *p)
{
    int image;
    for (image = 0; image < IMAGES; image++) {
        const size_t bytes = describe_image(p, image);
        char *memory = p->memory[INFO[image].place];
        p->images[image].host = memory ? (uint8_t *)memory + bytes * (size_t)INFO[image].plane : NULL;
${keep_size}
    }
}

static int allocate(${name}_pipeline *p, size_t most)
{
    size_t needed[PLACES] = {0};
    int image, place;
    for (image = 0; image < IMAGES; image++) {
        const size_t bytes = describe_image(p, image) * (size_t)(INFO[image].plane + 1);
        place = INFO[image].place;
        needed[place] = bytes > needed[place] ? bytes : needed[place];
    }
    for (place = 0; place < FIRST_OUTSIDE; place++) {
        p->bytes += needed[place] + ALIGNMENT + MARGIN;
    }
    for (place = 0; place < FIRST_OUTSIDE && p->bytes <= most; place++) {
        const size_t bytes = needed[place] + ALIGNMENT + MARGIN;
        char *memory = calloc(1, bytes);
        if (!memory) {
            return 0;
        }
        p->allocated[place] = memory;
        p->memory[place] = memory + (ALIGNMENT - (uintptr_t)memory % ALIGNMENT);
    }
    return p->bytes <= most;
}

${fill_floats}
${name}_status ${name}_create(int width, int height, ${name}_pipeline **pipeline)
{
    return ${name}_create_within(width, height, (size_t)-1, pipeline);
}

${name}_status ${name}_create_within(int width, int height, size_t most_bytes, ${name}_pipeline **pipeline)
{
    ${name}_pipeline *p;
    if (!pipeline) {
        return ${name}_no_image;
    }
    *pipeline = NULL;
    if (width < LEAST_WIDTH || height < 1 || width > MAX_SIZE || height > MAX_SIZE) {
        return ${name}_bad_size;
    }
    p = calloc(1, sizeof *p);
    if (!p) {
        return ${name}_no_memory;
    }
    halide_set_error_handler(keep_message);
    p->width = width;
    p->height = height;
    p->rows = (height + SCALE - 1) / SCALE;
    p->columns = (width + SCALE - 1) / SCALE;
    p->bytes = sizeof *p;
${defaults}
    if (!allocate(p, most_bytes)) {
        ${name}_destroy(p);
        return ${name}_no_memory;
    }
${take_blocks}
${flats}
    *pipeline = p;
    return ${name}_ok;
}

void ${name}_destroy(${name}_pipeline *p)
{
    int place;
${free_blocks}
    for (place = 0; p && place < PLACES; place++) {
        free(p->allocated[place]);
    }
    free(p);
}

void ${name}_reset(${name}_pipeline *p)
{
    p->has_past = 0;
}

void ${name}_set_progress(${name}_pipeline *p, ${name}_progress progress, void *user)
{
    p->progress = progress;
    p->user = user;
}

void ${name}_get_settings(const ${name}_pipeline *p, ${name}_settings *settings)
{
    *settings = p->settings;
}

${name}_status ${name}_set_settings(${name}_pipeline *p, const ${name}_settings *settings)
{
    /* By setting, in order: the largest value, and whether 0 is allowed. */
    static const double MOST[] = {${most}};
    static const int ZERO[] = {${zero}};
    static const char *const NAMES[] = {${setting_names}};
    const double *values = (const double *)settings;
    size_t k;
    for (k = 0; k < sizeof MOST / sizeof *MOST; k++) {
        if (!(values[k] >= 0.0 && values[k] <= MOST[k] && (values[k] > 0.0 || ZERO[k]))) {
            snprintf(p->message, sizeof p->message, "the setting %s must be %s 0 and at most %g", NAMES[k],
                     ZERO[k] ? "at least" : "above", MOST[k]);
            return ${name}_bad_setting;
        }
    }
    p->settings = *settings;
    return ${name}_ok;
}

const char *${name}_get_message(const ${name}_pipeline *p)
{
    return p->message;
}

size_t ${name}_count_bytes(const ${name}_pipeline *p)
{
    return p->bytes;
}

static const char *const STAGE_NAMES[${name}_stages] = {
${stage_names}
};

const char *${name}_get_stage(const ${name}_pipeline *p, int stage, double *seconds)
{
    if (stage < 0 || stage >= ${name}_stages) {
        return NULL;
    }
    *seconds = p->seconds[stage];
    return STAGE_NAMES[stage];
}

/* The steps. */

static ${name}_status fail(${name}_pipeline *p, const char *step, int code)
{
    snprintf(p->message, sizeof p->message, "%s failed with code %d: %.120s", step, code, halide_message);
    return ${name}_failed;
}

static void compute_numbers(${name}_pipeline *p)
{
    p->numbers.unused = 0;
${derived}
}

${stages}

${name}_status ${name}_run(${name}_pipeline *p, const ${name}_camera *camera, const ${name}_frame *frame)
{
    ${name}_status status = ${name}_ok;
    static ${name}_status (*const stages[${name}_stages])(${name}_pipeline *) = {
${stage_table}
    };
    int k;
    if (!p) {
        return ${name}_no_image;
    }
    if (!camera || !frame) {
        return refuse(p, ${name}_no_image, "camera or frame is NULL");
    }
${checks}
    if (!make_view(camera, p->width, p->height, &p->view)) {
        return refuse(p, ${name}_bad_camera, ${name}_explain(${name}_bad_camera));
    }
${given}
    if (!p->has_past) {
        p->view_before = p->view;
${forgetting}
    }
    p->frame = frame;
    place_images(p);
    compute_numbers(p);
    for (k = 0; k < ${name}_stages && status == ${name}_ok; k++) {
        const clock_t start = clock();
        if (p->progress && p->progress(p->user, k, ${name}_stages)) {
            status = refuse(p, ${name}_cancelled, ${name}_explain(${name}_cancelled));
            break;
        }
        status = stages[k](p);
        p->seconds[k] = (double)(clock() - start) / CLOCKS_PER_SEC;
    }
${finish}
    p->frame = NULL;
    if (status == ${name}_ok) {
        p->view_before = p->view;
        p->has_past = 1;
${swapping}
    }
    return status;
}
