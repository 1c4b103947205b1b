#include "lib/cover/envelope.h"
#include "lib/num/fixed.h"
#include "lib/spline/surface.h"

// One axis of a box, clipped to the frame: its middle, as a place; half its width in knot intervals, Q20, rounded up;
// and the coefficients that shape the surface between its ends.
struct span {
    struct canopy_place middle;
    int64_t half;
    uint32_t first, last;
};

#define LONGEST ((int64_t)((uint64_t)UINT32_MAX << 30))  // no coordinate is further from an origin

// floor(at / pitch) of a place that is not beyond the far edge; the last knot belongs to the last interval.
static uint32_t interval_of(int64_t at, uint32_t pitch, uint32_t size) {
    const uint32_t interval = (uint32_t)((uint64_t)at >> 30) / pitch;
    return interval < size - 1 ? interval : size - 2;
}

static struct canopy_place place_of(int64_t at, uint32_t pitch, uint32_t size) {
    const uint32_t interval = interval_of(at, pitch, size);
    const uint64_t rest = (uint64_t)at - ((uint64_t)interval * pitch << 30);  // at most pitch * 2^30
    return (struct canopy_place){interval, (int32_t)(rest / pitch)};
}

static bool clip(const struct canopy_frame *frame, int a, int64_t from, int64_t to, struct span *span) {
    const uint32_t pitch = frame->pitch[a], size = frame->size[a];
    const uint64_t width = canopy_frame_width(frame, a);
    const int64_t limit = width < UINT32_MAX ? (int64_t)(width << 30) : LONGEST;
    if (from > to || from > limit || to < 0) {
        return false;
    }
    const int64_t low = from > 0 ? from : 0, high = to < limit ? to : limit, middle = low + (high - low) / 2;
    const uint32_t h = interval_of(low, pitch, size), last = interval_of(high, pitch, size) + 2;
    span->middle = place_of(middle, pitch, size);
    span->half = canopy_div_ceil(high - middle, (int64_t)((uint64_t)pitch << 10));
    span->first = h > 0 ? h - 1 : 0;
    span->last = last < size ? last : size - 1;
    return true;
}

static int32_t larger(int32_t most, int32_t difference) {
    difference = difference < 0 ? -difference : difference;
    return difference > most ? difference : most;
}

// The largest differences of neighbouring coefficients along u and along v: the surface's slopes a knot interval are
// convex combinations of them.
static void find_steepest(const struct canopy_envelope *envelope, const struct span span[2], int32_t most[2]) {
    const uint32_t n = envelope->frame.size[1];
    most[0] = most[1] = 0;
    for (uint32_t i = span[0].first; i <= span[0].last; i++) {
        const int32_t *row = envelope->coefficients + (size_t)i * n;
        for (uint32_t j = span[1].first; j <= span[1].last; j++) {
            most[0] = i < span[0].last ? larger(most[0], row[j + n] - row[j]) : most[0];
            most[1] = j < span[1].last ? larger(most[1], row[j + 1] - row[j]) : most[1];
        }
    }
}

enum canopy_status canopy_envelope_over(const struct canopy_envelope *envelope, const int64_t from[2],
                                        const int64_t to[2], int32_t *low, int32_t *high) {
    const struct canopy_frame *frame = &envelope->frame;
    struct span span[2];
    if (!clip(frame, 0, from[0], to[0], &span[0]) || !clip(frame, 1, from[1], to[1], &span[1])) {
        return CANOPY_OUT_OF_FRAME;
    }
    const int32_t height =
        canopy_surface_fx(envelope->coefficients, frame->size, &span[0].middle, &span[1].middle, NULL);
    int64_t error = CANOPY_SURFACE_FX_ERROR;
    if (span[0].half > 0 || span[1].half > 0) {
        int32_t most[2];
        find_steepest(envelope, span, most);
        // Half widths are below 2^30, differences at most 2^29.
        error += canopy_shift_ceil(most[0] * span[0].half + most[1] * span[1].half, 20);
    }
    bool clipped = false;
    *low = canopy_narrow(height - error, &clipped);
    *high = canopy_narrow(height + error, &clipped);
    return CANOPY_OK;
}
