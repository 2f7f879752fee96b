/* The box of an image, or the first rows of the memory of a band; dims is memory for its axes. */
static halide_buffer_t crop(const ${name}_pipeline *p, int image, halide_dimension_t *dims)
{
    halide_buffer_t part = p->images[image];
    const struct image_info *info = &INFO[image];
    const ptrdiff_t bytes = part.type.bits / 8;
    int axis;
    for (axis = 0; axis < info->axes; axis++) {
        const int shape = info->shape[info->axes - 1 - axis];
        dims[axis] = part.dim[axis];
        if (shape == BAND) {
            dims[axis].extent = p->box.height;
        } else if (shape == HEIGHT || shape == WIDTH) {
            dims[axis].extent = shape == HEIGHT ? p->box.height : p->box.width;
            part.host += bytes * dims[axis].stride * (shape == HEIGHT ? p->box.top : p->box.left);
        }
    }
    part.dim = dims;
    return part;
}
