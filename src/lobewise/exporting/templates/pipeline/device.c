/* part: declare */
extern const struct halide_device_interface_t *halide_${api}_device_interface(void);
enum { BLOCKS = PLACES + ${planes} };

/* Memory on the device, as numbers of 32 bits. */
struct block {
    halide_buffer_t words;
    halide_dimension_t dim;
};
/* part: blocks */
    size_t sizes[IMAGES];
    struct block blocks[BLOCKS];
/* part: keep_size */
        p->sizes[image] = bytes;
/* part: take_blocks */
    {
        const ${name}_status status = take_blocks(p, most_bytes);
        if (status != ${name}_ok) {
            ${name}_destroy(p);
            return status;
        }
    }
/* part: free_blocks */
    if (p) {
        free_blocks(p);
    }
/* part: finish */
${copies}
/* part: device */
/* The device. A place that its kernels name has memory there, a block. Planes of a larger image are copied through blocks
   of their own. A block says which copy is newer by the flags of Halide's buffers. */
static const int BLOCK[IMAGES] = {
${image_blocks}
};

static int copy_down(${name}_pipeline *p, int block)
{
    halide_buffer_t *words = &p->blocks[block].words;
    const int is_newer = words->device && (words->flags & halide_buffer_flag_device_dirty);
    words->dim = &p->blocks[block].dim;
    return is_newer ? halide_copy_to_host(NULL, words) : 0;
}

/* Makes the block of an image describe the image's memory. */
static halide_buffer_t *point_block(${name}_pipeline *p, int image)
{
    struct block *block = &p->blocks[BLOCK[image]];
    block->words.host = p->images[image].host;
    block->words.dim = &block->dim;
    block->dim.extent = (int32_t)((p->sizes[image] + 3) / 4);
    return &block->words;
}

static void mark_host(${name}_pipeline *p, int place)
{
    p->blocks[place].words.flags = halide_buffer_flag_host_dirty;
}

/* Before a step of the host: images that it reads. Both lists end with -1. */
static int begin_on_host(${name}_pipeline *p, const int *reads)
{
    int code = 0;
    for (; *reads >= 0 && !code; reads++) {
        code = copy_down(p, INFO[*reads].place);
    }
    return code;
}

static void end_on_host(${name}_pipeline *p, const int *writes)
{
    for (; *writes >= 0; writes++) {
        mark_host(p, INFO[*writes].place);
    }
}

/* Before a kernel of the device: images that it reads, and images that it writes. */
static int begin_on_device(${name}_pipeline *p, const int *reads, const int *writes)
{
    int code = 0;
    for (; *reads >= 0 && !code; reads++) {
        halide_buffer_t *image = &p->images[*reads], *words;
        if (BLOCK[*reads] != INFO[*reads].place) {
            code = copy_down(p, INFO[*reads].place);
            mark_host(p, BLOCK[*reads]);
        }
        words = point_block(p, *reads);
        code = code ? code : halide_copy_to_device(NULL, words, halide_${api}_device_interface());
        image->device = words->device;
        image->device_interface = words->device_interface;
        image->flags = words->flags;
    }
    for (; *writes >= 0 && !code; writes++) {
        halide_buffer_t *image = &p->images[*writes], *words;
        if (BLOCK[*writes] != INFO[*writes].place) {
            code = copy_down(p, INFO[*writes].place);
        }
        words = point_block(p, *writes);
        image->device = words->device;
        image->device_interface = words->device_interface;
        image->flags = 0;
    }
    return code;
}

static int end_on_device(${name}_pipeline *p, const int *writes)
{
    int code = 0;
    for (; *writes >= 0 && !code; writes++) {
        const int block = BLOCK[*writes];
        p->blocks[block].words.flags = halide_buffer_flag_device_dirty;
        if (block != INFO[*writes].place) {
            code = copy_down(p, block);
            mark_host(p, INFO[*writes].place);
        }
    }
    return code;
}

/* Halide prints how its allocator is set up. */
static void keep_silent(void *context, const char *message)
{
    (void)context;
    (void)message;
}

/* Takes memory on the device, in multiples of 256 bytes: Halide's allocator for Vulkan needs that. */
static ${name}_status take_blocks(${name}_pipeline *p, size_t most)
{
    size_t needed[BLOCKS] = {0};
    halide_print_t before;
    int image, block, is_there = 1;
    for (image = 0; image < IMAGES; image++) {
        if (BLOCK[image] >= 0) {
            const size_t bytes = (describe_image(p, image) + 255) / 256 * 256;
            block = BLOCK[image];
            needed[block] = bytes > needed[block] ? bytes : needed[block];
        }
    }
    for (block = 0; block < BLOCKS; block++) {
        p->bytes += needed[block];
    }
    if (p->bytes > most) {
        return ${name}_no_memory;
    }
    before = halide_set_custom_print(keep_silent);
${configure}
    for (block = 0; block < BLOCKS && is_there; block++) {
        halide_buffer_t *words = &p->blocks[block].words;
        words->type.code = halide_type_float;
        words->type.bits = 32;
        words->type.lanes = 1;
        words->dimensions = 1;
        words->dim = &p->blocks[block].dim;
        words->dim->stride = 1;
        words->dim->extent = (int32_t)(needed[block] / 4);
        is_there = needed[block] <= INT32_MAX &&
                   (!needed[block] || !halide_device_malloc(NULL, words, halide_${api}_device_interface()));
        mark_host(p, block);
    }
    halide_set_custom_print(before);
    return is_there ? ${name}_ok : ${name}_no_device;
}

static void free_blocks(${name}_pipeline *p)
{
    int block;
    for (block = BLOCKS - 1; block >= 0; block--) {
        if (p->blocks[block].words.device) {
            p->blocks[block].words.dim = &p->blocks[block].dim;
            halide_device_free(NULL, &p->blocks[block].words);
        }
    }
}
