/* Makes all numbers of a place one value. */
static void fill_floats(${name}_pipeline *p, int place, float value)
{
    float *memory = p->memory[place];
    size_t k, count = 0;
    int image;
    for (image = 0; image < IMAGES; image++) {
        const size_t entries = describe_image(p, image) / sizeof(float);
        count = INFO[image].place == place && entries > count ? entries : count;
    }
    for (k = 0; k < count; k++) {
        memory[k] = value;
    }
}
