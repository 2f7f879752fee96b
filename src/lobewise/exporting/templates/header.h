/* ${title}, compiled for ${target}. Made by lobewise; README.md says how to call it. */
#ifndef ${guard}
#define ${guard}

#include "HalideRuntime.h"

#ifdef __cplusplus
extern "C" {
#endif

${declared}

/* Describes an image of floats, row after row, with the channels of a pixel together. With 0 channels the image has no
   axis for channels. dim is memory for three axes and must live as long as the result. */
static inline halide_buffer_t ${name}_floats(halide_dimension_t *dim, float *pixels, int channels, int width, int height)
{
    const int sizes[3] = {channels, width, height};
    static halide_buffer_t empty; /* all zeros */
    halide_buffer_t image = empty;
    int stride = 1, axis;
    for (axis = channels ? 0 : 1; axis < 3; axis++) {
        halide_dimension_t *d = &dim[image.dimensions++];
        d->min = 0;
        d->extent = sizes[axis];
        d->stride = stride;
        d->flags = 0;
        stride *= sizes[axis];
    }
    image.host = (uint8_t *)pixels;
    image.type.code = halide_type_float;
    image.type.bits = 32;
    image.type.lanes = 1;
    image.dim = dim;
    image.flags = halide_buffer_flag_host_dirty; /* a device, if there is one, has no copy yet */
    return image;
}

/* Describes a mask, one byte for each pixel. */
static inline halide_buffer_t ${name}_bytes(halide_dimension_t *dim, uint8_t *pixels, int width, int height)
{
    halide_buffer_t image = ${name}_floats(dim, (float *)0, 0, width, height);
    image.host = pixels;
    image.type.code = halide_type_uint;
    image.type.bits = 8;
    return image;
}

#ifdef __cplusplus
}
#endif

#endif
