/* Filters frame.raw with ${name}_filter, writes output.raw and compares it with expected.raw, which Python made.
   README.md says how to build the program. Run it in this folder; its exit code is 0 if both results agree. */
#include <math.h>
#include <stdio.h>
#include <stdlib.h>

#include "${name}.h"

enum { WIDTH = ${width}, HEIGHT = ${height}, PIXELS = WIDTH * HEIGHT };

/* Halide's default handler would abort the program. */
static void on_error(void *context, const char *message)
{
    (void)context;
    fprintf(stderr, "%s\n", message);
}

static void *allocate(size_t bytes)
{
    void *memory = malloc(bytes);
    if (!memory) {
        fprintf(stderr, "out of memory\n");
        exit(1);
    }
    return memory;
}

static FILE *open_file(const char *path, const char *mode)
{
    FILE *file = fopen(path, mode);
    if (!file) {
        fprintf(stderr, "%s: cannot be opened\n", path);
        exit(1);
    }
    return file;
}

static void *read_image(FILE *file, size_t bytes)
{
    void *memory = allocate(bytes);
    if (fread(memory, 1, bytes, file) != bytes) {
        fprintf(stderr, "a file ends too early\n");
        exit(1);
    }
    return memory;
}

static void check(int code, const char *what)
{
    if (code) {
        fprintf(stderr, "%s failed with code %d\n", what, code);
        exit(1);
    }
}

int main(void)
{
    FILE *file;
    float *found, *expected;
    double largest = 0.0;
    int k;
${declarations}
    halide_set_error_handler(on_error);

    /* Read the arrays of the frame, one after the other. */
    file = open_file("frame.raw", "rb");
${reading}
    fclose(file);

${making}${calls}
    found = (float *)output.host;
    file = open_file("output.raw", "wb");
    if (fwrite(found, sizeof(float), ${channels} * PIXELS, file) != ${channels} * PIXELS || fclose(file)) {
        fprintf(stderr, "output.raw: cannot be written\n");
        return 1;
    }

    file = open_file("expected.raw", "rb");
    expected = (float *)read_image(file, ${channels} * PIXELS * sizeof(float));
    fclose(file);
    for (k = 0; k < ${channels} * PIXELS; k++) {
        double difference = fabs((double)found[k] - expected[k]);
        if (difference > 0.0) {
            difference /= fabs((double)expected[k]);
        }
        if (!(difference <= largest)) {
            largest = difference;
        }
    }
    printf("largest relative difference: %.2e\n", largest);
    return largest <= ${bound} ? 0 : 1;
}
