/* ${title}, compiled for ${target}. Made by lobewise ${version}; README.md says how to use it. */
#ifndef ${guard}
#define ${guard}

#include <stddef.h>

#ifdef __cplusplus
extern "C" {
#endif

/* What a function returns: ${name}_ok, or why it did nothing. ${name}_explain gives a sentence. */
typedef enum ${name}_status {
    ${name}_ok = 0,
    ${name}_no_memory = 1,
    ${name}_bad_size = 2,   /* width or height out of range */
    ${name}_no_image = 3,   /* a pointer of the frame is NULL */
    ${name}_bad_camera = 4, /* a number is not finite, or up is parallel to forward */
    ${name}_bad_setting = 5, /* out of range */
    ${name}_bad_place = 6,  /* the shaded pixel is not inside its block */
    ${name}_failed = 7,     /* a kernel failed; the message says which */
    ${name}_cancelled = 8,  /* the function of ${name}_set_progress asked for it */
    ${name}_no_device = 9   /* the graphics processor of the target cannot be used, or has not enough memory */
} ${name}_status;

/* A pipeline: the steps of the plan, the images between them${history_word}. */
typedef struct ${name}_pipeline ${name}_pipeline;

/* A pinhole camera in world space. Its vectors need no unit length. */
typedef struct ${name}_camera {
    double position[3];
    double forward[3]; /* where it looks */
    double up[3];      /* any vector that is not parallel to forward */
    double fov_y;      /* full vertical angle of view, radians, above 0 and below pi */
    double fov_x;      /* full horizontal angle; 0 for square pixels */
    double shift[2];   /* offset of the image's centre on the plane at distance 1: right, up; 0 for most cameras */
} ${name}_camera;

/* Numbers that may be set before each frame. */
typedef struct ${name}_settings {
${settings}
} ${name}_settings;

/* The images of a frame: dense arrays of float, row 0 on top, the channels of a pixel together.
   The pipeline reads and writes them during ${name}_run alone. */
typedef struct ${name}_frame {
    /* Inputs. */
${inputs}
    /* Results. */
${results}
} ${name}_frame;

/* Makes a pipeline for images of ${least} x 1 to 32768 x 32768 pixels. Free it with ${name}_destroy. */
${name}_status ${name}_create(int width, int height, ${name}_pipeline **pipeline);
/* The same, unless the pipeline would hold more bytes than most_bytes: ${name}_no_memory then. */
${name}_status ${name}_create_within(int width, int height, size_t most_bytes, ${name}_pipeline **pipeline);
void ${name}_destroy(${name}_pipeline *pipeline); /* NULL is allowed */

/* The numbers of a pipeline; they stay until they are set again. */
void ${name}_get_settings(const ${name}_pipeline *pipeline, ${name}_settings *settings);
${name}_status ${name}_set_settings(${name}_pipeline *pipeline, const ${name}_settings *settings);

/* Denoises a frame. Several pipelines may run at once, each in one thread at a time. */
${name}_status ${name}_run(${name}_pipeline *pipeline, const ${name}_camera *camera, const ${name}_frame *frame);

/* Before each part of a frame ${name}_run calls this function with the number of parts that are done and of all parts.
   If it returns another value than 0, the frame is cancelled, and the pipeline is as it was before the frame. NULL for
   no function. */
typedef int (*${name}_progress)(void *user, int done, int parts);
void ${name}_set_progress(${name}_pipeline *pipeline, ${name}_progress progress, void *user);

/* Forgets all frames before: call it at a camera cut${reset_word}. */
void ${name}_reset(${name}_pipeline *pipeline);

/* The last thing that went wrong, one sentence, and what a status means. */
const char *${name}_get_message(const ${name}_pipeline *pipeline);
const char *${name}_explain(${name}_status status);

/* Bytes that a pipeline holds, those on a device included. */
size_t ${name}_count_bytes(const ${name}_pipeline *pipeline);

/* The parts of the last frame: processor time of each, all threads together. NULL from part ${name}_stages on. */
enum { ${name}_stages = ${stage_count} };
const char *${name}_get_stage(const ${name}_pipeline *pipeline, int stage, double *seconds);

#ifdef __cplusplus
}
#endif

#endif
