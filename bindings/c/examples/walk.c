// A motion from text through two anchors: what a firmware would start from. C99; printf is only there to show something.
#include <stdio.h>

#include "motionette.h"

// The model in flash; blob.S puts it there on a 16-byte boundary.
extern const unsigned char model_blob[], model_blob_end[];

// As many bytes as mtn_model_plan says, and 15 to reach a 16-byte boundary.
static uint64_t arena[168 * 1024 / sizeof(uint64_t)];
static mtn_model model;
static mtn_generator generator;

static int failed(const char *what, mtn_result result) {
    if (result.error == MTN_ERROR_NONE) return 0;
    printf("%s: %s (index %u, found %u, limit %u)\n", what, mtn_error_message(result.error), (unsigned)result.index,
           (unsigned)result.found, (unsigned)result.limit);
    return 1;
}

// A real one would feed the watchdog, and abort when a new command has come in.
static mtn_flow progress(void *calls, const mtn_progress *now) {
    (void)now;
    *(unsigned *)calls += 1;
    return MTN_FLOW_CONTINUE;
}

// Prints metres as centimetres.
static void print_cm(const char *what, float metres) {
    unsigned hundredths = (unsigned)(metres * 10000.0f);
    printf("%s %u.%02u cm\n", what, hundredths / 100, hundredths % 100);
}

int main(void) {
    if (failed("model", mtn_model_open(&model, model_blob, (size_t)(model_blob_end - model_blob)))) return 1;

    const mtn_limits limits = {.frames = 60, .words = 8, .anchors = 2, .steps = 5, .exact = 1, .guidance = 2.0f};
    mtn_plan plan;
    if (failed("plan", mtn_model_plan(&model, &limits, &plan))) return 1;
    printf("plan: %u bytes of arena, %u million multiply-accumulates\n", (unsigned)plan.arena_bytes,
           (unsigned)(plan.macs / 1000000));
    if (failed("generator", mtn_generator_open(&generator, &model, arena, sizeof arena))) return 1;
    if (failed("self-test", mtn_self_test(&generator))) return 1;

    const mtn_anchor anchors[] = {
        {.frame = 30, .family = MTN_FAMILY_ROOT3D, .position = {0.2f, 0.9f, 1.6f}},
        {.frame = 50, .family = MTN_FAMILY_JOINT, .joint = MTN_JOINT_RIGHT_WRIST, .position = {-0.2f, 1.4f, 2.8f}},
    };
    mtn_request request = mtn_request_default();
    request.text = "a person walks forward";
    request.frames = 60;
    request.steps = 5;
    request.seed = 7;
    request.anchors = anchors;
    request.anchor_count = sizeof anchors / sizeof anchors[0];

    unsigned calls = 0;
    mtn_motion motion;
    if (failed("generate", mtn_generate(&generator, &request, progress, &calls, &motion))) return 1;
    printf("%u frames, %u tokens, %u calls of progress\n", (unsigned)motion.frames, (unsigned)motion.token_count, calls);
    char understood[256];
    if (failed("understood", mtn_motion_understood(&generator, &motion, understood, sizeof understood))) return 1;
    if (understood[0]) printf("understood as: %s\n", understood);
    print_cm("control error before refinement", motion.control_error_before);
    print_cm("control error", motion.control_error);
    print_cm("right wrist at frame 50, height", motion.joints[50][MTN_JOINT_RIGHT_WRIST][1]);

    uint64_t hash;
    if (failed("hash", mtn_motion_hash(&motion, &hash))) return 1;
    printf("motion %08x%08x\n", (unsigned)(hash >> 32), (unsigned)hash);
    return 0;
}
