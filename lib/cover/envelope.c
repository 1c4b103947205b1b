#include "lib/cover/envelope.h"

#include "lib/num/bits.h"
#include "lib/spline/surface.h"

static bool inside(const struct canopy_frame *frame, uint32_t u, uint32_t v) {
    return u <= canopy_frame_width(frame, 0) && v <= canopy_frame_width(frame, 1);
}

bool canopy_envelope_covers(const struct canopy_envelope *envelope, uint32_t u, uint32_t v) {
    const struct canopy_frame *frame = &envelope->frame;
    const struct canopy_place pu = canopy_place_of(u, frame->pitch[0], frame->size[0]);
    const struct canopy_place pv = canopy_place_of(v, frame->pitch[1], frame->size[1]);
    const uint32_t bit = pu.interval * (frame->size[1] - 1U) + pv.interval;
    return canopy_bit_get(envelope->coverage, bit);
}

enum canopy_status canopy_envelope_height(const struct canopy_envelope *envelope, uint32_t u, uint32_t v, int32_t *low,
                                          int32_t *high) {
    const struct canopy_frame *frame = &envelope->frame;
    if (!inside(frame, u, v)) {
        return CANOPY_OUT_OF_FRAME;
    }
    const struct canopy_place pu = canopy_place_of(u, frame->pitch[0], frame->size[0]);
    const struct canopy_place pv = canopy_place_of(v, frame->pitch[1], frame->size[1]);
    const int32_t height = canopy_surface_fx(envelope->coefficients, frame->size, &pu, &pv, NULL);
    *low = height - CANOPY_SURFACE_FX_ERROR;
    *high = height + CANOPY_SURFACE_FX_ERROR;
    return CANOPY_OK;
}
